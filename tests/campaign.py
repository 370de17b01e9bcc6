"""Try to lose files, to hang, and to get a traceback out of every command, and count.

    python tests/campaign.py --out results/campaign

Commands are killed and called again, called two at once, given damaged files, malformed input and
outputs that cannot be (`tests/campaigning/`). What was found is written down at once: after Ctrl-C
the same command goes on. A case is repeated by ``--only PART:NUMBER``, which leaves nothing out of
what the programs say.
"""

import argparse
import hashlib
import json
import queue
import signal
import sys
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from tempfile import TemporaryDirectory

from campaigning import damages, kills, known, malformed, pairs, places
from campaigning.home import Home
from campaigning.processes import ROOT
from campaigning.workplace import References, Workplace
from tqdm import tqdm

from lf_flame._common import provenance
from lf_flame._common.atomic_files import write_json, write_text

PARTS = {
    kills.PART: kills, pairs.PART: pairs, damages.PART: damages, malformed.PART: malformed,
    known.PART: known, places.PART: places,
}  # fmt: skip

SAID = {
    kills.PART: "Killed or interrupted, then called again",
    pairs.PART: "Two at once",
    damages.PART: "Damaged files",
    malformed.PART: "Malformed input",
    known.PART: "Known to have been mistaken somewhere",
    places.PART: "Links, devices, pipes, full disks",
}


def draw_cases(parts: list[str], seed: int, quick: bool) -> list:
    """Draw the cases of some parts."""
    return [case for part in parts for case in PARTS[part].cases(seed, quick)]


def program_key() -> str:
    """Hash the programs: what was found of others does not count."""
    digest = hashlib.sha256()
    folders = (ROOT / "lf_flame", ROOT / "experiments", ROOT / "tests" / "campaigning")
    for path in sorted(path for folder in folders for path in folder.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def key_of(case, program: str, seed: int) -> str:
    """Tell a case from others, and from the same one of another program."""
    text = f"{program}:{seed}:{case.part}:{case.number}:{case.name}"
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def try_out(case, workplace: Workplace, key: str) -> dict:
    """Try a case out, and write down what was found."""
    start = time.monotonic()
    try:
        wrong = case.try_out(workplace)
    except Exception as error:  # a mistake of the campaign, which must not end with it
        wrong = f"the campaign failed: {error!r}"[:300]
    return {
        "key": key, "part": case.part, "number": case.number, "command": case.name,
        "what": case.what, "right": not wrong, "wrong": wrong,
        "seconds": round(time.monotonic() - start, 2),
    }  # fmt: skip


def run(cases: list, keys: list[str], jobs: int, record: Path, learning: bool) -> None:
    """Try cases out side by side, and write down what was found, one line each."""
    idle: queue.SimpleQueue[Workplace] = queue.SimpleQueue()
    stopped = threading.Event()
    with TemporaryDirectory(prefix="campaign-") as folder, ThreadPoolExecutor(jobs) as pool:
        tqdm.write("Making the files that the commands read", file=sys.stderr)
        home = Home(Path(folder) / "home", learning)
        references = References(home)
        places_ = [
            Workplace(Path(folder) / f"place-{k}", home, references, learning) for k in range(jobs)
        ]
        for place in places_:
            idle.put(place)

        def at_a_workplace(case, key):
            if stopped.is_set():
                return None
            place = idle.get()
            try:
                return try_out(case, place, key)
            finally:
                idle.put(place)

        try:
            found = [pool.submit(at_a_workplace, *pair) for pair in zip(cases, keys, strict=True)]
            with record.open("a", encoding="utf-8") as file:
                for future in tqdm(as_completed(found), "cases", len(found), unit="case"):
                    file.write(json.dumps(future.result()) + "\n")
                    file.flush()
            home.check()
        finally:
            stopped.set()
            pool.shutdown(cancel_futures=True)
            for place in places_:
                place.end()


def read_rows(record: Path) -> dict[str, dict]:
    """Read what was found before, by key; a line that was cut off is left out."""
    rows = {}
    for line in record.read_text(encoding="utf-8").splitlines() if record.exists() else ():
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue
        rows[row["key"]] = row
    return rows


def summary(rows: list[dict]) -> dict:
    """Count cases, right and wrong."""
    right = sum(row["right"] for row in rows)
    return {"cases": len(rows), "right": right, "wrong": len(rows) - right}


def report(rows: list[dict], made: dict) -> str:
    """Tell in Markdown what was found: part by part, and every case that is wrong."""
    total = summary(rows)
    parts = [
        "# A campaign against the commands\n",
        f"{total['cases']} cases of {made['drawn']}, **{total['wrong']} wrong**. "
        f"Seed {made['seed']}"
        f"{', quick' if made['quick'] else ''}; {made['machine']}, revision "
        f"{made['git_revision']}, {made['date']}. Command: `{made['command']}`. One case again: "
        f"`python tests/campaign.py --seed {made['seed']} --only PART:NUMBER`.\n",
    ]
    for part, said in SAID.items():
        some = [row for row in rows if row["part"] == part]
        if some:
            parts.append(_table(f"{said} (`{part}`)", some))
    wrong = [row for row in rows if not row["right"]]
    if wrong:
        parts.append("## Wrong\n\n" + "\n".join(map(_line, wrong)) + "\n")
    return "\n".join(parts)


def _table(title: str, rows: list[dict]) -> str:
    total = summary(rows)
    seconds = sum(row["seconds"] for row in rows)
    lines = [f"## {title}\n", "| | cases | right | wrong |", "|---|---|---|---|"]
    for name in Counter(row["command"] for row in rows):
        one = summary([row for row in rows if row["command"] == name])
        lines.append(f"| {name} | {one['cases']} | {one['right']} | {one['wrong']} |")
    lines.append(
        f"| **all**, {seconds / 60:.1f} min of one process | **{total['cases']}** | "
        f"**{total['right']}** | **{total['wrong']}** |\n"
    )
    return "\n".join(lines)


def _line(row: dict) -> str:
    return f"- `{row['part']}:{row['number']}` {row['command']}: {row['what']}. **{row['wrong']}**"


def main(arguments: list[str] | None = None) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--out", type=Path, default=Path("results/campaign"), help="results folder")
    parser.add_argument("--quick", action="store_true", help="some cases of each part alone")
    parser.add_argument("--jobs", type=int, default=provenance.cpu_count(), help="side by side")
    parser.add_argument("--seed", type=int, default=1, help="of the draw (default: 1)")
    parser.add_argument("--part", choices=PARTS, action="append", help="this part alone")
    parser.add_argument("--only", metavar="PART:NUMBER", help="this case alone; nothing is kept")
    asked = parser.parse_args(arguments)
    cases = draw_cases(asked.part or list(PARTS), asked.seed, asked.quick and not asked.only)
    if asked.only:
        cases = [case for case in cases if f"{case.part}:{case.number}" == asked.only]
        if not cases:
            parser.error(f"there is no case {asked.only}")
    sys.exit(_carry_out(cases, asked))


def _carry_out(cases: list, asked: argparse.Namespace) -> int:
    made = provenance.environment()
    made |= {"seed": asked.seed, "quick": asked.quick, "drawn": len(cases)}
    program = program_key()
    keys = [key_of(case, program, asked.seed) for case in cases]
    with TemporaryDirectory() as nowhere:
        out = Path(nowhere) if asked.only else asked.out
        out.mkdir(parents=True, exist_ok=True)
        record = out / "campaign.jsonl"
        found = read_rows(record)
        left = [(case, key) for case, key in zip(cases, keys, strict=True) if key not in found]
        try:
            if left:
                run(*map(list, zip(*left, strict=True)), asked.jobs, record, not asked.quick)
        except KeyboardInterrupt:
            print("\nStopped; the same command goes on.")
        found = read_rows(record)
        rows = [found[key] for key in keys if key in found]
        write_json(out / "campaign.json", made | summary(rows) | {"rows": rows})
        write_text(out / "campaign.md", report(rows, made))
    print(report(rows, made))
    return int(summary(rows)["right"] < len(cases))


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C
    signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever a shell has left ignored
    main()
