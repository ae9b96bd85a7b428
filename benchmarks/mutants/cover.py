"""Which test runs which line: recorded once, read for every mutant."""

from __future__ import annotations

import difflib
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

from coverage import CoverageData

ENVIRONMENT = {"OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg", "PYTHONHASHSEED": "0"}
PYTEST = ["-p", "no:cacheprovider", "-p", "no:randomly", "-q"]
"""Its arguments: results depend on nothing that happened before."""

LOOKING = "tests/api/test_signatures.py"
"""Tests that look at definitions and run none of them."""

INTERRUPTED = "not ctrl_c and not interrupt"
"""Tests that send interrupts: under a tracer they reach it, not the code."""


def record(root: Path, folder: Path, tests: list[str]) -> None:
    """Run tests (paths from the root) and add what they cover to the map in a folder, path by path."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in tests:
        name = path.replace("/", "_")
        data, times = folder / f".coverage.{name}", folder / f"{name}.xml"
        options = ["--cov=gnc_opt", "--cov-context=test", "--cov-report=", f"--junitxml={times}", path]
        options += ["-k", INTERRUPTED]
        environment = {**os.environ, **ENVIRONMENT, "PYTHONPATH": str(root), "COVERAGE_FILE": str(data)}
        code = subprocess.run(
            [sys.executable, "-m", "pytest", *PYTEST, *options],
            cwd=root,
            env=environment,
            preexec_fn=heed_interrupts,
        ).returncode
        if code not in (0, 1):  # tests that fail anyway are left out of the map
            raise SystemExit(f"pytest ended with code {code} in {path}.")
        files = {str(f.relative_to(root)): _kept(f, folder) for f in sorted((root / "gnc_opt").rglob("*.py"))}
        (folder / f"{name}.json").write_text(json.dumps({"root": str(root), "files": files}))


def heed_interrupts() -> None:
    """What runs in the background inherits that interrupts are ignored; some tests send them."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _kept(file: Path, folder: Path) -> str:
    """Keep the version of a file that the lines of a map count in, and return its name."""
    version = hashlib.sha256(file.read_bytes()).hexdigest()
    (folder / "versions").mkdir(exist_ok=True)
    shutil.copyfile(file, folder / "versions" / version)
    return version


def _lines_now(before: Path, now: Path) -> dict[int, int]:
    """Line numbers of today by those of another version, where a line has stayed."""
    old, new = before.read_text().splitlines(), now.read_text().splitlines()
    blocks = difflib.SequenceMatcher(None, old, new, autojunk=False).get_matching_blocks()
    return {b.a + i + 1: b.b + i + 1 for b in blocks for i in range(b.size)}


@dataclass(frozen=True)
class Cover:
    """The map.

    Attributes
    ----------
    lines : dict
        Tests by file and line.
    seconds : dict
        How long each test took when it was recorded.
    """

    lines: dict[str, dict[int, set[str]]]
    seconds: dict[str, float]

    @classmethod
    def read(cls, root: Path, folder: Path, files: set[str]) -> Cover:
        """Read the map of some files; of another version of a file it counts where a line has stayed."""
        lines: dict[str, dict[int, set[str]]] = {file: {} for file in files}
        seconds: dict[str, float] = {}
        for part in sorted(folder.glob("*.json")):  # written last: what is being recorded has none yet
            recorded = json.loads(part.read_text())
            here = _durations(part.with_suffix(".xml"))
            seconds |= here
            data = CoverageData(str(folder / f".coverage.{part.stem}"))
            data.read()
            for file in files & recorded["files"].keys():
                places = _lines_now(folder / "versions" / recorded["files"][file], root / file)
                found = data.contexts_by_lineno(str(Path(recorded["root"]) / file))
                for line in found.keys() & places.keys():
                    tests = {c.split("|")[0] for c in found[line]} & here.keys()
                    lines[file].setdefault(places[line], set()).update(tests)
        return cls(lines, seconds)

    @property
    def modules(self) -> list[str]:
        """The files that hold the tests."""
        return sorted({t.split("::")[0] for t in self.seconds})

    def only(self, present: set[str]) -> Cover:
        """Return the map without tests that have gone since it was recorded."""
        lines = {f: {n: tests & present for n, tests in found.items()} for f, found in self.lines.items()}
        return Cover(lines, {t: s for t, s in self.seconds.items() if t in present})

    def tests(self, file: str, span: tuple[int, int], budget: float) -> list[str]:
        """Return the tests that come by some lines, and the others of their modules, up to a time budget (s).

        Those of the file's own package, and of parts by hand, before others, the quickest first; what one test of a
        module has computed, the others may have used from a cache.
        """
        direct = {t for n in range(span[0], span[1] + 1) for t in self.lines[file].get(n, ())}
        if not direct:  # run on import
            direct = {t for tests in self.lines[file].values() for t in tests}
            direct |= {t for t in self.seconds if t.startswith(LOOKING)}
        modules = {t.split("::")[0] for t in direct}
        beside = {t for t in self.seconds if t.split("::")[0] in modules} - direct
        chosen, total = [], 0.0
        own = (f"tests/{Path(file).parts[1]}/", "tests/unit/")
        for group in (direct, beside):
            for test in sorted(group, key=lambda t: (not t.startswith(own), self.seconds.get(t, 0.0), t)):
                total += self.seconds.get(test, 0.0)
                if chosen and total > budget:
                    break
                chosen.append(test)
        cost: dict[str, float] = {}
        for test in chosen:
            module = test.split("::")[0]
            cost[module] = cost.get(module, 0.0) + self.seconds.get(test, 0.0)
        # Module by module: fixtures are shared.
        return sorted(
            chosen, key=lambda t: (cost[t.split("::")[0]], t.split("::")[0], self.seconds.get(t, 0.0))
        )


def _durations(times: Path) -> dict[str, float]:
    """Seconds by test from pytest's report."""
    cases = ET.parse(times).getroot().iter("testcase")
    return {
        f"{c.attrib['classname'].replace('.', '/')}.py::{c.attrib['name']}": float(c.attrib["time"])
        for c in cases
        if not any(c.find(end) is not None for end in ("skipped", "failure", "error"))
    }
