"""The README's example and the commands it names."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_python_example_runs():
    (example,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert "assert " in example  # it checks its own result
    exec(compile(example, "README.md", "exec"), {})


def test_plan_it_shows_is_what_the_program_prints():
    (shown,) = re.findall(r"```text\n(effect .*?)\n```", README, re.DOTALL)
    command = [sys.executable, "-m", "lf_flame", "plan", "data_gen/scenes/effects.toml"]
    command += ["--tolerance", "0.005"]
    printed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert shown.strip() == printed.strip()


def test_files_and_targets_it_names_exist():
    for path in re.findall(r"\]\(([^)#]+)\)", README):
        assert (ROOT / path).exists(), path
    shown = subprocess.run(["make", "help"], cwd=ROOT, capture_output=True, text=True, check=True)
    for target in set(re.findall(r"`?make ([a-z-]+)", README)):
        assert f"  {target} " in shown.stdout, target


def test_tables_are_made_in_a_fresh_clone(tmp_path):
    """Results that came with the clone do not stand for runs that are not there."""
    for name in ("Makefile", "setup.cfg", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path)
    for folder in ("data_gen", "experiments"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    for table in ("table1.csv", "table2.csv"):
        (tmp_path / "experiments" / "results" / "quick" / table).touch()
    command = ["make", "-n", "tables", "PRESET=quick", "RUN=quick"]
    asked = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    for step in ("dataset", "train", "evaluate"):
        for kind in ("shapes", "flames"):
            assert re.search(rf"lf-flame {step} \S*{kind}", asked), (step, kind)


def test_every_deviation_the_code_cites_is_listed():
    text = (ROOT / "experiments" / "DEVIATIONS.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^\| (\d+) \|", text, re.MULTILINE))
    files = [*ROOT.glob("lf_flame/**/*.py"), *ROOT.glob("*/*.toml"), ROOT / "README.md"]
    cited = {n for path in files for n in re.findall(r"deviation (\d+)", path.read_text())}
    assert cited
    assert cited <= listed
