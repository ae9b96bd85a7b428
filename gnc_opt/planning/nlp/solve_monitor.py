"""Monitoring of a solve: progress, interrupts and time limits at each iteration."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import FrameType
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
import numpy.typing as npt

from gnc_opt.array_types import Array, Mask
from gnc_opt.errors import ArgumentError


@dataclass(frozen=True)
class IterationInfo:
    """Data passed to the progress callback.

    Parameters
    ----------
    iteration
        0 for the (projected) initial point.
    objective
        f at the iterate.
    infeasibility
        Largest violation of a bound on x or g, >= 0.
    """

    iteration: int
    objective: float
    infeasibility: float


ProgressCallback: TypeAlias = Callable[[IterationInfo], "bool | None"]


@dataclass(frozen=True)
class Bounds:
    """Bounds of a vector, (n,) each."""

    lower: Array
    upper: Array

    @classmethod
    def create_checked_bounds(cls, name: str, lower: Array, upper: Array) -> Bounds:
        box = cls(lower, upper)
        wrong = ~(box.lower <= box.upper) | (box.lower == np.inf) | (box.upper == -np.inf)
        if wrong.any():
            i = int(np.argmax(wrong))
            raise ArgumentError(
                f"the bounds of {name}[{i}] admit no number: {box.lower[i]} to {box.upper[i]}"
            )
        return box

    @property
    def is_fixed(self) -> Mask:
        return np.asarray(self.lower == self.upper, dtype=np.bool_)

    def compute_largest_bound_violation(self, value: Array) -> float:
        return max(
            0.0,
            float(np.max(self.lower - value, initial=0.0)),
            float(np.max(value - self.upper, initial=0.0)),
        )


@dataclass
class MonitoredSolve:
    """Data of the monitor for the current solve."""

    box_x: Bounds
    box_g: Bounds
    callback: ProgressCallback | None
    deadline: float
    stop: bool = False
    count: int = 0
    error: BaseException | None = None

    def record_iterate(self, x: Array, f: float, g: Array) -> None:
        """Record an iterate; sets `stop` on errors and never raises."""
        try:
            if self.callback is not None:
                infeasibility = max(
                    self.box_x.compute_largest_bound_violation(x),
                    self.box_g.compute_largest_bound_violation(g),
                )
                if self.callback(IterationInfo(self.count, f, infeasibility)):
                    self.stop = True
        except BaseException as error:  # raised again after the solver has returned
            self.error, self.stop = error, True
        self.count += 1
        if time.perf_counter() > self.deadline:
            self.stop = True


class Monitor(ca.Callback):  # type: ignore[misc]
    """The `iteration_callback` of `nlpsol`: passes each iterate to the watch and stops the solver on request."""

    def __init__(self, nx: int, ng: int, n_parameters: int) -> None:
        super().__init__()
        self._rows = {"x": nx, "f": 1, "g": ng, "lam_x": nx, "lam_g": ng, "lam_p": n_parameters}
        self.run: MonitoredSolve | None = None
        self.construct("monitor")

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> Any:
        return ca.Sparsity.dense(self._rows[ca.nlpsol_out(i)], 1)

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, arg: Any, res: Any) -> int:
        run = self.run
        if run is not None:
            x, f, g = (
                _view_casadi_buffer(arg[i], self._rows[name]) for i, name in enumerate(("x", "f", "g"))
            )
            run.record_iterate(x, float(f[0]), g)
            _view_casadi_buffer(res[0], 1)[0] = float(run.stop)
        return 0


@contextlib.contextmanager
def stop_on_sigint(run: MonitoredSolve) -> Iterator[None]:
    """Let the first Ctrl-C stop the solve; the previous handler receives the next one."""
    previous = signal.getsignal(signal.SIGINT)
    ignored = previous in (None, signal.SIG_IGN)
    if ignored or threading.current_thread() is not threading.main_thread():
        yield
        return

    def request_solver_stop(signum: int, frame: FrameType | None) -> None:
        run.stop = True
        signal.signal(signal.SIGINT, previous)

    signal.signal(signal.SIGINT, request_solver_stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)


def _view_casadi_buffer(buffer: Any, size: int) -> Array:
    """Return a view of a CasADi buffer, (size,); NaN for values that the plugin does not report."""
    if size == 0 or buffer is None:
        return np.full(size, np.nan)
    return np.frombuffer(buffer, dtype=np.float64)


def convert_to_float_vector(name: str, value: npt.ArrayLike, size: int) -> Array:
    """Return a new vector (size,) from a vector or a scalar."""
    array = np.asarray(value, dtype=np.float64)
    if array.ndim == 0:
        return np.full(size, float(array))
    if array.shape != (size,):
        raise ArgumentError(f"{name} must have shape ({size},), got {array.shape}")
    return array.copy()
