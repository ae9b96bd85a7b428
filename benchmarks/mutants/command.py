"""Record the map, run a sample, list the survivors."""

from __future__ import annotations

import argparse
import json
import random
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.mutants.cover import Cover, record
from benchmarks.mutants.mutations import keys, mutants_of
from benchmarks.mutants.trial import Trials, copy_tree

ROOT = Path(__file__).resolve().parents[2]
EQUIVALENT = Path(__file__).with_name("equivalent.json")


def main(argv: Sequence[str] | None = None) -> None:
    """Read the command line."""
    parser = _parser()
    arguments = parser.parse_args(argv)
    if arguments.command == "record":
        record(ROOT, arguments.map, arguments.tests or _all_tests())
        return
    if arguments.command == "run":
        _run(arguments)
    print(report(arguments.session))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.mutants",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command", required=True)
    recording = commands.add_parser("record", help="run tests and note which lines each of them runs")
    recording.add_argument("--map", type=Path, required=True, help="folder of the map; what is there is kept")
    recording.add_argument(
        "tests", nargs="*", help="files or folders, e.g. tests/verify; default: all of them"
    )
    running = commands.add_parser("run", help="try a sample of mutants, or go on with one")
    running.add_argument("--map", type=Path, required=True)
    running.add_argument(
        "--session", type=Path, required=True, help="JSON lines; what is in it is not repeated"
    )
    running.add_argument(
        "--package", action="append", required=True, help="e.g. gnc_opt/control; may be repeated"
    )
    running.add_argument("--sample", type=int, default=30, help="mutants of each package")
    running.add_argument("--seed", type=int, default=1)
    running.add_argument(
        "--budget", type=float, default=60.0, help="seconds of tests for each mutant, as recorded"
    )
    running.add_argument("--again", action="store_true", help="try survivors again, after new tests")
    listing = commands.add_parser("report", help="print the table and the survivors of a session")
    listing.add_argument("--session", type=Path, required=True)
    parser.epilog = "\n".join(command.format_usage() for command in (recording, running, listing))
    return parser


def _all_tests() -> list[str]:
    return [str(p.relative_to(ROOT)) for p in sorted((ROOT / "tests").iterdir()) if any(p.glob("test_*.py"))]


def _run(arguments: argparse.Namespace) -> None:
    done, reasons = _read(arguments.session), _equivalent()
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copy = Path(folder)
        copy_tree(ROOT, copy)
        trials = Trials(copy)
        for package in arguments.package:
            every = list(keys(mutants_of(ROOT, package)))
            order = random.Random(arguments.seed).sample(
                every, len(every)
            )  # a larger sample holds a smaller one
            todo = [(k, m) for k, m in order[: arguments.sample] if k not in done]
            if arguments.again:
                todo += [(k, m) for k, m in order if k in done and _lives(done[k]) and k not in reasons]
            if not todo:
                continue
            cover = Cover.read(ROOT, arguments.map, {m.file for _, m in todo})
            cover = cover.only(trials.collected(cover.modules))
            for key, mutant in todo:
                outcome = trials.attempt(mutant, cover, arguments.budget)
                entry = {
                    "key": key,
                    "package": package,
                    "of": len(every),
                    "place": f"{mutant.file}:{mutant.line}",
                    "diff": mutant.diff((ROOT / mutant.file).read_bytes()),
                    **asdict(outcome),
                }
                with arguments.session.open("a") as session:
                    session.write(json.dumps(entry) + "\n")
                print(f"{outcome.result:9} {outcome.seconds:6.1f} s  {entry['place']}", flush=True)


def _read(session: Path) -> dict[str, dict[str, Any]]:
    """Entries by key; the last one counts."""
    lines = session.read_text().splitlines() if session.exists() else []
    return {entry["key"]: entry for entry in map(json.loads, lines)}


def _equivalent() -> dict[str, str]:
    """Reasons by key, of mutants that no test could kill."""
    return dict(json.loads(EQUIVALENT.read_text()))


def _lives(entry: dict[str, Any]) -> bool:
    return entry["result"] in ("survived", "uncovered")


def report(session: Path) -> str:
    """Return the table package x outcomes, and the survivors."""
    entries = _read(session)
    reasons = _equivalent()
    columns = ("all", "sampled", "killed", "timeout", "survived", "equivalent", "share killed")
    lines = [f"{'package':28}" + "".join(f"{column:>13}" for column in columns)]
    for package in dict.fromkeys(e["package"] for e in entries.values()):
        here = {k: e for k, e in entries.items() if e["package"] == package}
        count = Counter("equivalent" if _lives(e) and k in reasons else e["result"] for k, e in here.items())
        killed = count["killed"] + count["timeout"]
        living = count["survived"] + count["uncovered"]
        share = f"{100 * killed / max(killed + living, 1):.1f} %"
        every = max(e["of"] for e in here.values())
        figures = (every, len(here), count["killed"], count["timeout"], living, count["equivalent"], share)
        lines.append(f"{package:28}" + "".join(f"{figure:>13}" for figure in figures))
    for key, entry in entries.items():
        if _lives(entry) and key not in reasons:
            lines += ["", f"{entry['place']}  {entry['result']} {entry['tests']} tests", entry["diff"]]
    return "\n".join(lines)
