"""Native: a CasADi function as machine code, from the C that CasADi writes for it, where there is a C compiler.

Every operation is the interpreter's, in its order, and none are fused: the results have the same bits. Libraries are
kept in the user's cache by what is in them, so that a function is compiled once per machine.
"""

from __future__ import annotations

import hashlib
import io
import os
import platform
import shutil
import subprocess
import tempfile
from contextlib import redirect_stderr
from pathlib import Path
from typing import Any

import casadi as ca

FLAGS = ("-std=c99", "-O1", "-ffp-contract=off", "-fPIC", "-shared")
"""Higher levels take many times as long and gain little: a kernel is one long function without loops."""

WORTH = 100_000
"""Evaluations that cost the interpreter about four times what compiling costs; both grow with the operations."""


def native(function: Any) -> str:
    """Return the path of a function's library, compiled now unless it has been; "" where that does not succeed."""
    compiler = shutil.which("cc")
    if compiler is None:
        return ""
    told = (ca.__version__, *FLAGS, platform.machine(), os.path.realpath(compiler), function.serialize())
    place = _cache() / f"{hashlib.sha256(chr(0).join(told).encode()).hexdigest()}.so"
    try:
        if not place.exists():
            _compile(function, compiler, place)
    except (OSError, RuntimeError):  # no place to write, no C for an operation: the interpreter does without
        return ""
    return str(place) if place.exists() else ""


def loaded(function: Any, library: str) -> Any:
    """Return a function from its library; the function itself where there is none on this machine."""
    return ca.external(function.name(), library) if library and os.path.exists(library) else function


def _cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gnc_opt"


def _compile(function: Any, compiler: str, place: Path) -> None:
    place.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=place.parent) as folder:
        generator = ca.CodeGenerator("kernel.c")
        with redirect_stderr(io.StringIO()) as told:
            generator.add(function)
            source = generator.generate(f"{folder}{os.sep}")
        if told.getvalue():  # CasADi has no C for a solver in it, and warns that this source does not compile
            return
        made = Path(folder, "kernel.so")
        done = subprocess.run(
            [compiler, *FLAGS, "-o", str(made), source, "-lm"], capture_output=True, check=False
        )
        if done.returncode == 0:
            made.replace(place)  # at once: others may be looking for it
