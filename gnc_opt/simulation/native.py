"""Native: the step of a kernel as machine code, from its operations in C, where there is a C compiler.

Every operation is the interpreter's, in its order, and none are fused: the results have the same bits. Around the step
goes a loop over the steps of a leg, so that nothing is copied between them but the states. A run and the flight beside
it are flown at once where vector registers take both (`gnc_opt.simulation.lanes`), else one after the other, by the C
that CasADi writes. A step that says that it is not enough (a law that solves a problem now and then, which has no C)
ends the loop before it. Libraries are kept in the user's cache by what is in them, so that a function is compiled once
per machine.
"""

from __future__ import annotations

import ctypes
import hashlib
import io
import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from contextlib import redirect_stderr
from pathlib import Path
from typing import Any

import casadi as ca

from gnc_opt.arrays import Array
from gnc_opt.errors import GncOptError
from gnc_opt.simulation.lanes import in_lanes

FLAGS = (
    "-std=c99",
    "-O1",
    "-fno-semantic-interposition",
    "-finline-small-functions",
    "-ffp-contract=off",
    "-fPIC",
    "-shared",
)
"""Higher levels take many times as long and gain little: a kernel is one long function without loops. That of absolute
values and squares is not called, but put in its place."""

WORTH = 100_000
"""Evaluations that cost the interpreter about four times what compiling costs; both grow with the operations."""


_LOOP = """
#include <stdlib.h>
#include <string.h>

CASADI_SYMBOL_EXPORT casadi_int leg(const casadi_real *X, const casadi_real *rows, const casadi_real *C,
                                    casadi_real *final, casadi_int n, casadi_int flights) {
  const casadi_int size = flights * STATES;
  casadi_int n_arg, n_res, n_iw, n_w, k = 0;
  casadi_real enough = 1;
  int failed = STEP_work(&n_arg, &n_res, &n_iw, &n_w);
  const casadi_real **arg = malloc(n_arg * sizeof *arg);
  casadi_real **res = malloc((n_res + 1) * sizeof *res), *w = malloc((n_w + size) * sizeof *w), *now = w + n_w;
  casadi_int *iw = malloc((n_iw + 1) * sizeof *iw);
  failed = failed || !arg || !res || !w || !iw;
  if (!failed) {
    STEP_incref();
    int memory = STEP_checkout();
    memcpy(final, X, size * sizeof *X);
    for (; k < n && !failed && enough == 1; k++) {
      memcpy(now, final, size * sizeof *now);
      for (casadi_int first = 0; first < size && !failed && enough == 1; first += STATES) {
        arg[0] = now + first;
        arg[1] = rows + k * KNOWN;
        arg[2] = C;
        res[0] = final + first;
        if (N_OUT > 1) res[1] = &enough;
        failed = STEP(arg, res, iw, w, memory);
      }
      if (enough != 1) {
        memcpy(final, now, size * sizeof *now);
        k--;
      }
    }
    STEP_release(memory);
    STEP_decref();
  }
  free(arg);
  free(res);
  free(w);
  free(iw);
  return failed ? -1 : k;
}
"""
"""A leg: the states X of all flights, then, step by step, those that follow, with one row of what is known each.
Returns how many steps were enough for all."""


def native(step: Any) -> str:
    """Return the path of the library of a step ``(X, w, C) -> X`` or ``(X, enough)``, compiled now unless it has been;
    "" where that does not succeed."""
    compiler = shutil.which("cc")
    if compiler is None:
        return ""
    lanes = in_lanes(step)
    told = (
        ca.__version__,
        *FLAGS,
        _LOOP,
        lanes,
        platform.machine(),
        os.path.realpath(compiler),
        step.serialize(),
    )
    place = _cache() / f"{hashlib.sha256(chr(0).join(told).encode()).hexdigest()}.so"
    try:
        if not place.exists():
            _compile(step, lanes, compiler, place)
    except (OSError, RuntimeError):  # no place to write, no C for an operation: the interpreter does without
        return ""
    return str(place) if place.exists() else ""


def loaded(library: str) -> Callable[[Array, Array, Array, Array], int] | None:
    """Return ``(X, rows, C, final)``, which writes to ``final`` the state after those first steps of a leg that were
    enough, and returns how many, from a library; ``None`` where there is none on this machine."""
    if not library or not os.path.exists(library):
        return None
    leg = ctypes.CDLL(library).leg
    leg.argtypes, leg.restype = [ctypes.c_void_p] * 4 + [ctypes.c_longlong] * 2, ctypes.c_longlong

    def fly(X: Array, rows: Array, C: Array, final: Array) -> int:
        flights = 1 if X.ndim == 1 else len(X)
        flown = leg(X.ctypes.data, rows.ctypes.data, C.ctypes.data, final.ctypes.data, len(rows), flights)
        if flown < 0:
            raise GncOptError(
                "a control step could not be evaluated: an assertion in it failed, or memory is short."
            )
        return int(flown)

    return fly


def _cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gnc_opt"


def _with_loop(source: str, step: Any) -> str:
    """Return the C of a step with that of a leg below it."""
    sizes = {"STATES": step.size1_in(0), "KNOWN": step.size1_in(1), "N_OUT": step.n_out()}
    loop = _LOOP
    for name, size in sizes.items():
        loop = loop.replace(name, str(size))
    return source + loop.replace("STEP", step.name())


def _source(step: Any, folder: str) -> str:
    """Return the C that CasADi writes for a step, with a leg; "" if it has none."""
    generator = ca.CodeGenerator("kernel.c")
    with redirect_stderr(io.StringIO()) as told:
        generator.add(step)
        written = Path(generator.generate(f"{folder}{os.sep}"))
    # CasADi has no C for a solver in it, and warns that this source does not compile
    return "" if told.getvalue() else _with_loop(written.read_text(encoding="utf-8"), step)


def _compile(step: Any, lanes: str, compiler: str, place: Path) -> None:
    """Make the library: of both flights in lanes if that can be, else of what CasADi writes."""
    place.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=place.parent) as folder:
        made, written = Path(folder, "kernel.so"), Path(folder, "leg.c")
        for source in (lanes, None):
            text = _source(step, folder) if source is None else source
            if not text:
                continue
            written.write_text(text, encoding="utf-8")
            command = [compiler, *FLAGS, "-o", str(made), str(written), "-lm"]
            if subprocess.run(command, capture_output=True, check=False).returncode == 0:
                made.replace(place)  # at once: others may be looking for it
                return
