"""One mutant: change the copy, run the tests that come by, put the copy back."""

from __future__ import annotations

import compileall
import os
import re
import shutil
import signal
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks.mutants.cover import ENVIRONMENT, PYTEST, Cover, heed_interrupts
from benchmarks.mutants.mutations import Mutant

PARTS = ("gnc_opt", "problems", "benchmarks", "tests", "docs", "README.md", "pyproject.toml")

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


def collected(copy: Path, modules: list[str]) -> set[str]:
    """Return the tests that the modules hold, by their names; stop if they cannot be collected without any change."""
    code, output = _pytest(copy, ["-o", "addopts=", "--collect-only", *modules], 600.0)
    if code != 0:
        raise SystemExit(f"the tests cannot be collected.\n{output[-2000:]}")
    return {line for line in output.splitlines() if "::" in line}


def attempt(copy: Path, mutant: Mutant, cover: Cover, budget: float) -> Outcome:
    """Run the tests against a mutant."""
    tests = cover.tests(mutant.file, mutant.lines, budget)
    if not tests:
        return Outcome("uncovered")
    file = copy / mutant.file
    source, stat = file.read_bytes(), file.stat()
    expected = sum(cover.seconds.get(t, 0.0) for t in tests)
    begin = time.monotonic()
    try:
        file.write_bytes(mutant.applied(source))
        code, output = _pytest(copy, ["-x", "--tb=no", *tests], OVERHEAD + PATIENCE * expected)
    finally:
        file.write_bytes(source)
        os.utime(file, ns=(stat.st_atime_ns, stat.st_mtime_ns))  # its compiled form stays valid
    seconds = round(time.monotonic() - begin, 1)
    if code is None:
        return Outcome("timeout", "", seconds, len(tests))
    first = re.search(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)
    by = first.group(1) if first else ""
    return Outcome("survived" if code == 0 else "killed", by, seconds, len(tests))


def _pytest(copy: Path, arguments: list[str], limit: float) -> tuple[int | None, str]:
    """Return pytest's exit code (None: out of time) and output."""
    environment = {**os.environ, **ENVIRONMENT, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    process = subprocess.Popen(
        [*PYTEST, *arguments],
        cwd=copy,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        preexec_fn=heed_interrupts,
    )
    try:
        output, _ = process.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)  # workers of the tests too
        process.communicate()
        return None, ""
    return process.returncode, output
