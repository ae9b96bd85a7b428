"""One mutant: change the copy, run the tests that come by, put the copy back.

Tests run in forks of a process that has imported what never changes; a test that kills is run without the change, once:
one that fails then too kills nothing.
"""

from __future__ import annotations

import compileall
import contextlib
import multiprocessing
import os
import re
import shutil
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks.mutants.cover import ENVIRONMENT, PYTEST, Cover
from benchmarks.mutants.mutations import Mutant

PARTS = ("gnc_opt", "problems", "benchmarks", "tests", "docs", "README.md", "pyproject.toml")

OWN = ("gnc_opt", "problems", "benchmarks", "tests")
"""Packages that a fork imports anew, from the copy."""

FOREIGN = (
    "pytest", "casadi", "rich", "matplotlib.pyplot", "scipy.integrate", "scipy.interpolate",
    "scipy.optimize", "scipy.signal", "scipy.sparse.linalg", "scipy.stats",
)  # fmt: skip
"""Packages that it finds imported."""

PATIENCE, OVERHEAD = 5.0, 60.0
"""A trial may take so many times as long as its tests did when they were recorded, and so many seconds more."""


@dataclass(frozen=True)
class Outcome:
    """How a trial ended: "killed", "survived", "timeout" or "uncovered"; and by which test, after how many seconds."""

    result: str
    by: str = ""
    seconds: float = 0.0
    tests: int = 0


def copy_tree(root: Path, copy: Path) -> None:
    """Copy what the tests need; the checkout itself is never changed."""
    for part in PARTS:
        if (root / part).is_dir():
            shutil.copytree(root / part, copy / part, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy2(root / part, copy / part)
    compileall.compile_dir(copy / "gnc_opt", quiet=1)


class Trials:
    """Trials in a copy of the tree, one after the other."""

    def __init__(self, copy: Path) -> None:
        self._copy = copy
        self._sound: dict[str, bool] = {}  # whether a test passes without any change
        os.environ.update(ENVIRONMENT)
        self._forks = multiprocessing.get_context("forkserver")
        self._forks.set_forkserver_preload(list(FOREIGN))

    def collected(self, modules: list[str]) -> set[str]:
        """Return the names of the tests that the modules hold; stop if they cannot be collected without any change."""
        present = [m for m in modules if (self._copy / m).exists()]
        arguments = ["-o", "addopts=", "--collect-only", *present]
        code, output = self._pytest(arguments, 600.0, compiled=True)
        if code != 0:
            raise SystemExit(f"the tests cannot be collected.\n{output[-2000:]}")
        return {line for line in output.splitlines() if "::" in line}

    def attempt(self, mutant: Mutant, cover: Cover, budget: float) -> Outcome:
        """Run the tests against a mutant."""
        tests = [t for t in cover.tests(mutant.file, mutant.lines, budget) if self._sound.get(t, True)]
        if not tests:
            return Outcome("uncovered")
        expected = sum(cover.seconds.get(t, 0.0) for t in tests)
        begin = time.monotonic()
        code, output = self._changed(mutant, ["-x", "--tb=no", *tests], OVERHEAD + PATIENCE * expected)
        seconds = round(time.monotonic() - begin, 1)
        if code is None:
            return Outcome("timeout", "", seconds, len(tests))
        if code == 0:
            return Outcome("survived", "", seconds, len(tests))
        first = re.search(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)
        by = first.group(1) if first else ""
        if by in cover.seconds and not self._passes(by):
            return self.attempt(mutant, cover, budget)
        return Outcome("killed", by, seconds, len(tests))

    def _passes(self, test: str) -> bool:
        if test not in self._sound:
            self._sound[test] = self._pytest([test], 10 * OVERHEAD)[0] == 0
        return self._sound[test]

    def _changed(self, mutant: Mutant, arguments: list[str], limit: float) -> tuple[int | None, str]:
        file = self._copy / mutant.file
        source, stat = file.read_bytes(), file.stat()
        try:
            file.write_bytes(mutant.applied(source))
            return self._pytest(arguments, limit)
        finally:
            file.write_bytes(source)
            os.utime(file, ns=(stat.st_atime_ns, stat.st_mtime_ns))  # its compiled form stays valid

    def _pytest(self, arguments: list[str], limit: float, compiled: bool = False) -> tuple[int | None, str]:
        """Return pytest's exit code (None: out of time) and output; what is compiled may be kept."""
        output = self._copy / "output.txt"
        arguments = [*PYTEST, *arguments]
        process = self._forks.Process(target=_run, args=(self._copy, output, arguments, compiled))
        process.start()
        process.join(limit)
        if process.is_alive():
            with contextlib.suppress(ProcessLookupError):  # it has just ended
                os.killpg(process.pid, signal.SIGKILL)  # workers of the tests too
            process.join()
            return None, ""
        return process.exitcode, output.read_text(errors="replace")


def _run(copy: Path, output: Path, arguments: list[str], compiled: bool) -> None:
    """Run pytest in a copy of the tree, in this process, and end it."""
    os.setsid()
    import pytest  # here, because what the tests write belongs in a file

    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.chdir(copy)
    for name in [n for n in sys.modules if n.split(".")[0] in OWN]:
        del sys.modules[name]
    sys.path[:] = [str(copy), *(p for p in sys.path if p not in ("", str(Path(__file__).parents[2])))]
    os.environ["PYTHONPATH"] = str(copy)
    if not compiled:
        sys.dont_write_bytecode, os.environ["PYTHONDONTWRITEBYTECODE"] = True, "1"
    file = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(file, 1)
    os.dup2(file, 2)
    code = int(pytest.main(arguments))
    sys.stdout.flush()
    os._exit(code)
