"""Execution of many control steps per call, by CasADi's interpreter or as machine code if a C compiler exists.

The machine code is CasADi's C code of the step in a loop, without fused operations; its results are bitwise identical.
A step in which the controller has to solve a problem ends the loop before that step.
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
from functools import cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.errors import GncOptError
from gnc_opt.simulation.control_step_casadi_function import LoopKernel


class StepExecutor:
    """Repeated step of a kernel; ``library`` is the path of the compiled `compiled_step_function`, or ""."""

    def __init__(self, kernel: LoopKernel, library: str = "") -> None:
        self.kernel, self.library = kernel, library
        self._buffers: dict[Any, Any] = {}

    def simulate_control_steps(self, X: Array, rows: Array, C: Array, final: Array) -> None:
        """Write the state (n_state,) after the steps (n_steps, n_known) of a segment to ``final``."""
        if self._machine_code_step_function is None:
            self._simulate_steps_in_casadi(X, rows, C, final)
            return
        n_done = self._machine_code_step_function(X, rows, C, final)
        while n_done < len(rows):  # a step for which the unconstrained law is not valid
            self._simulate_steps_in_casadi(final.copy(), rows[n_done : n_done + 1], C, final)
            n_done += 1
            n_done += self._machine_code_step_function(final.copy(), rows[n_done:], C, final)

    def compute_initial_loop_state_and_constants(self, known: Array, P: Array) -> tuple[Array, Array]:
        """Return the initial X (n_state,) and the constants (n_constants,) of a run."""
        start, constants = self.kernel.start, self.kernel.constants
        X, C = np.empty(start.size1_out(0)), np.empty(constants.size1_out(0))
        P = np.ascontiguousarray(P)
        self._evaluate_casadi_into_arrays("start", lambda: start, (np.ascontiguousarray(known), P), X)
        self._evaluate_casadi_into_arrays("constants", lambda: constants, (P,), C)
        return X, C

    def _simulate_steps_in_casadi(self, X: Array, rows: Array, C: Array, final: Array) -> None:

        def build_step_sequence_function() -> Any:
            return self._build_step_sequence_function(
                lambda x, w, c, n: [self.step_function_without_log.fold(n)(x, w, c)], len(rows)
            )

        self._evaluate_casadi_into_arrays(len(rows), build_step_sequence_function, (X, rows, C), final)

    def _evaluate_casadi_into_arrays(
        self, key: Any, function: Callable[[], Any], arguments: tuple[Array, ...], *results: Array
    ) -> None:
        """Write the results of a function of contiguous arrays to ``results``, without conversions."""
        if key not in self._buffers:
            step_loops = self.kernel.step_sequence_functions
            if key not in step_loops:
                step_loops[key] = function()
            self._buffers[key] = step_loops[key].buffer()
        buffer, evaluate = self._buffers[key]
        for k, array in enumerate(arguments):
            buffer.set_arg(k, memoryview(array.data))
        for k, result in enumerate(results):
            buffer.set_res(k, memoryview(result.data))
        evaluate()

    def propagate_steps_with_log(self, X: Array, rows: Array, C: Array) -> tuple[Array, Array]:
        """Return the states (n_state, n_steps + 1) and the logs (n_log, n_steps) of a segment."""
        count, step = len(rows), self.kernel.step
        columns, logs = np.empty((count + 1, X.size)), np.empty((count, self.kernel.log.size))

        def build_step_sequence_with_log() -> Any:
            return self._build_step_sequence_function(
                lambda x, w, c, n: [ca.densify(o) for o in step.mapaccum(n)(x, w, c)], count
            )

        columns[0] = X
        self._evaluate_casadi_into_arrays(
            ("logged", count), build_step_sequence_with_log, (columns[0], rows, C), columns[1:], logs
        )
        return columns.T, logs.T

    @cached_property
    def _machine_code_step_function(self) -> Callable[[Array, Array, Array, Array], int] | None:
        return load_control_step_library(self.library)

    @property
    def compiled_step_function(self) -> Any:
        return self.kernel.unconstrained_step or self.step_function_without_log

    @cached_property
    def step_function_without_log(self) -> Any:
        """Step without log, so that quantities that only the log contains are not computed."""
        step = self.kernel.step
        symbols = step.sx_in() if step.is_a("SXFunction") else step.mx_in()
        return ca.Function("only", symbols, [step(*symbols)[0]], ["X", "w", "C"], ["X_next"])

    def _build_step_sequence_function(
        self, outputs: Callable[[Any, Any, Any, int], list[Any]], count: int
    ) -> Any:
        step = self.kernel.step
        x, w, c = (ca.MX.sym(n, *size) for n, size in (
            ("X", (self.kernel.state.size,)), ("w", (self.kernel.known.size, count)), ("C", (step.size1_in(2),))
        ))  # fmt: skip
        return ca.Function("step_sequence", [x, w, c], outputs(x, w, ca.repmat(c, 1, count), count))


FLAGS = ("-std=c99", "-O1", "-fno-semantic-interposition", "-finline-small-functions", "-ffp-contract=off", "-fPIC",
         "-shared")  # fmt: skip
"""Compiler flags: a kernel has no loops, and higher levels compile much longer with little gain."""

MIN_EVALUATIONS_TO_COMPILE = 100_000
"""Evaluations above which compilation pays; interpreted they take about 4 times as long as the compilation."""

_LOOP = Path(__file__).with_name("step_loop.c").read_text(encoding="utf-8")
"""C function: propagates X over rows of known values."""


def build_control_step_library(step: Any) -> str:
    """Return the library path of a step ``(X, w, C) -> X`` or ``(X, valid)``; "" if it cannot be compiled."""
    compiler = shutil.which("cc")
    if compiler is None:
        return ""
    compiled = (platform.machine(), os.path.realpath(compiler), step.serialize())
    key = (ca.__version__, *FLAGS, _LOOP, *compiled)
    place = (
        Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        / "gnc_opt"
        / f"{hashlib.sha256(chr(0).join(key).encode()).hexdigest()}.so"
    )
    try:
        if not place.exists():
            _compile_control_step_library(step, compiler, place)
    except (OSError, RuntimeError):  # not writable, or no C code for an operation
        return ""
    return str(place) if place.exists() else ""


def load_control_step_library(library: str) -> Callable[[Array, Array, Array, Array], int] | None:
    """Return the library function ``(X, rows, C, final)``, which returns the steps done; ``None`` without library."""
    if not library or not os.path.exists(library):
        return None
    step_loop = ctypes.CDLL(library).propagate_steps
    step_loop.argtypes, step_loop.restype = [ctypes.c_void_p] * 4 + [ctypes.c_longlong], ctypes.c_longlong

    def call_control_step_library(X: Array, rows: Array, C: Array, final: Array) -> int:
        n_done = step_loop(X.ctypes.data, rows.ctypes.data, C.ctypes.data, final.ctypes.data, len(rows))
        if n_done < 0:
            raise GncOptError(
                "a control step could not be evaluated: an assertion in it failed, or memory is short."
            )
        return int(n_done)

    return call_control_step_library


def _append_c_loop_over_steps(source: str, step: Any) -> str:
    sizes = {"STATES": step.size1_in(0), "KNOWN": step.size1_in(1), "N_OUT": step.n_out()}
    loop = _LOOP
    for name, size in sizes.items():
        loop = loop.replace(name, str(size))
    return source + loop.replace("STEP", step.name())


def _generate_step_c_source(step: Any, folder: str) -> str:
    generator = ca.CodeGenerator("kernel.c")
    with redirect_stderr(io.StringIO()) as messages:
        generator.add(step)
        written = Path(generator.generate(f"{folder}{os.sep}"))
    # CasADi generates no C code for solvers, and warns that this source does not compile
    return "" if messages.getvalue() else _append_c_loop_over_steps(written.read_text(encoding="utf-8"), step)


def _compile_control_step_library(step: Any, compiler: str, place: Path) -> None:
    place.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=place.parent) as folder:
        library, source = Path(folder, "kernel.so"), Path(folder, "step_loop.c")
        text = _generate_step_c_source(step, folder)
        if not text:
            return
        source.write_text(text, encoding="utf-8")
        command = [compiler, *FLAGS, "-o", str(library), str(source), "-lm"]
        if subprocess.run(command, capture_output=True, check=False).returncode == 0:
            library.replace(place)  # atomic: other processes may look for it
