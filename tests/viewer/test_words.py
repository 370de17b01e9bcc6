"""The copied command, as the page's own script makes it."""

import json
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

import lf_flame.viewer

WORDS = Path(lf_flame.viewer.__file__).parent / "static" / "words.js"
STATE = {"slope": 0.5, "shape": "square", "width": 1, "ring": 0, "centre": [0, 0], "gain": 1,
         "gamma": 1}  # fmt: skip


@pytest.mark.parametrize(
    ("source", "named"),
    [("-x", "./-x"), ("--out", "./--out"), ("a b's.npy", "a b's.npy"), ("/a/-x", "/a/-x")],
)
def test_a_copied_command_takes_no_name_for_an_option(tmp_path, source, named):
    if not (node := shutil.which("node")):
        pytest.skip("there is no node")
    shutil.copy(WORDS, tmp_path / "words.mjs")
    metadata = json.dumps({"source": source, "reading": {"white": "-w"}, "making": {}})
    (tmp_path / "call.mjs").write_text(
        'import { command } from "./words.mjs";\n'
        f"console.log(command({metadata}, {json.dumps(STATE)}));\n"
    )
    said = subprocess.run([node, tmp_path / "call.mjs"], capture_output=True, text=True, check=True)
    words = shlex.split(said.stdout)
    assert words == ["lf-flame", "refocus", named, "--white=-w", "--slope", "0.5"]
