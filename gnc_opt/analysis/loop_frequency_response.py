r"""Frequency response of a closed loop with all its components, at instants of its nominal run.

The loop is opened at the output of the controller. With d added to the command u of the linearised step
(`Linearization`) of the closed loop,

.. math:: \delta X^+ = A\, \delta X + B\, d, \qquad u = C\, \delta X,

the open loop is :math:`L(z) = -C (z - A + B C)^{-1} B`, the sensitivity :math:`S = (1 + L)^{-1}` and the complementary
sensitivity :math:`T = L S`. Sampling, hold, sensors, estimator, delays and lags are included; each instant is linear
time-invariant. The margins are defined in `gnc_opt.control.loop_margins`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.analysis.closed_loop_linearization import Linearization
from gnc_opt.argument_checks import StrictAttributes, read_float_array, read_integer, require_type
from gnc_opt.array_types import Array
from gnc_opt.control.loop_margins import Margins, compute_stability_margins, mask_states_on_input_output_path
from gnc_opt.control.sampled_data_discretization import convert_to_continuous_poles
from gnc_opt.errors import ArgumentError
from gnc_opt.model.model_variables import Layout
from gnc_opt.numerical_tolerances import ROUNDING
from gnc_opt.simulation.actuators import ZeroOrderHold
from gnc_opt.simulation.closed_loop import ClosedLoop
from gnc_opt.simulation.sensor_and_actuator_block import Block, Defaults, Parameters, Step, StepContext
from gnc_opt.threads_and_package_versions import limit_to_one_thread

_PROBE = "probe of the command"

_STABLE = 1.0 + 1e-9
"""Largest pole magnitude of a stable loop; uncontrollable integrators have poles at 1."""

_LOOKS = np.array([0.01, 0.1, 0.5])
"""Frequencies of the test for an open loop, as shares of the Nyquist frequency."""


@dataclass(frozen=True)
class _CommandPerturbation(Block):
    def parameters(self, size: int, unit: str) -> Defaults:
        return {"d": (np.zeros(size), unit)}

    @property
    def is_memoryless(self) -> bool:
        return True

    def step(self, tick: StepContext, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        return Step(signal + p["d"], state)


@dataclass(frozen=True, eq=False)
class LoopResponse(StrictAttributes):
    """Loop opened at its commands, at instants of a run; see `loop_response`. Frequencies are in rad/s.

    Attributes
    ----------
    times : array (n_times,)
        s.
    a, b, c : array
        Closed loop from d to u: (n_times, n, n), (n_times, n, m), (n_times, m, n).
    dt : float
        Control step, s.
    commands : Layout

    Examples
    --------
    >>> response = loop_response(loop, x0=[1.0, 0.0], tf=8.0)
    >>> print(f"|S| at 1 rad/s: {abs(response.sensitivity([1.0])).item():.2f}")
    |S| at 1 rad/s: 0.63
    """

    times: Array
    a: Array
    b: Array
    c: Array
    dt: float
    commands: Layout = field(repr=False)

    def open_loop(self, omega: ArrayLike, index: int = 0) -> Array:
        """Return L, (n_omega, m, m) complex, at the instant ``index``."""
        closed = self._evaluate_closed_loop_transfer(omega, index)
        left = np.eye(closed.shape[1]) + closed
        if np.any(np.linalg.norm(left, -2, axis=(1, 2)) <= ROUNDING * np.linalg.norm(closed, 2, axis=(1, 2))):
            raise _build_pole_on_axis_error()
        return _solve_linear_systems(left.transpose(0, 2, 1), -closed.transpose(0, 2, 1)).transpose(0, 2, 1)

    def sensitivity(self, omega: ArrayLike, index: int = 0) -> Array:
        """Return the sensitivity S, (n_omega, m, m) complex, from d to the input of the actuators."""
        closed = self._evaluate_closed_loop_transfer(omega, index)
        return np.asarray(np.eye(closed.shape[1]) + closed)

    def channel_open_loop(self, omega: ArrayLike, command: str, index: int = 0) -> Array:
        """Return the open loop of one command with the others closed, (n_omega,) complex."""
        i = self.commands.labels.index(self._require_controller_command_label(command))
        return np.asarray(1 / self.sensitivity(omega, index)[:, i, i] - 1)

    def poles(self, index: int = 0) -> Array:
        """Return the poles z of the closed loop, (n,) complex."""
        return np.asarray(np.linalg.eigvals(self.a[self._check_time_index(index)]).astype(complex))

    def is_stable(self, index: int = 0) -> bool:
        """Return whether the linearised loop is stable at the instant ``index``."""
        return bool(np.all(np.abs(self.poles(index)) <= _STABLE))

    def margins(self, index: int = 0) -> Margins:
        """Return gain, phase, delay and disk margins at the instant ``index``.

        Raises
        ------
        ArgumentError
            The linearised loop is unstable, or open because all commands are at their limits.
        """
        if not self.is_stable(index):
            z = max(self.poles(index), key=abs)
            raise ArgumentError(
                f"the loop linearised at {self.times[index]:g} s is unstable (pole {z:.6g}) and has no margins: "
                "see poles()."
            )
        if self._is_loop_open(index):
            raise ArgumentError(
                f"the loop linearised at {self.times[index]:g} s is open: its commands have no effect "
                "(they are at their limits), and it has no margins; choose other instants (at=)."
            )
        a, b, c = self.a[index], self.b[index], self.c[index]
        return compute_stability_margins(a - b @ c, b, -c, self.dt)

    @property
    def disk_margins(self) -> Array:
        """Disk margins at all instants, (n_times,); 0 for an unstable loop, NaN for an open one."""

        def compute_disk_margin_at_time(k: int) -> float:
            if not self.is_stable(k):
                return 0.0
            return np.nan if self._is_loop_open(k) else float(self.margins(k).disk)

        return np.array([compute_disk_margin_at_time(k) for k in range(self.times.size)])

    @property
    def frequencies(self) -> Array:
        """Relevant frequencies, (n,) rad/s: two decades about the poles, up to half the sampling rate."""
        poles = np.concatenate([self.poles(k) for k in range(self.times.size)])
        sizes = np.abs(convert_to_continuous_poles(poles[np.abs(poles) > 1e-6], self.dt))
        top = np.pi / self.dt
        low = 0.01 * min(float(np.min(sizes[sizes > 1e-6 * top], initial=top)), 0.1 * top)
        return np.logspace(np.log10(low), np.log10(top), 400)

    def _is_loop_open(self, index: int) -> bool:
        """Return whether the law has feedback but its commands do not reach the plant."""
        fed_back = bool(np.any(self.c[index]))
        return fed_back and bool(
            np.all(np.abs(self._evaluate_closed_loop_transfer(_LOOKS * np.pi / self.dt, index)) < ROUNDING)
        )

    @limit_to_one_thread()
    def _evaluate_closed_loop_transfer(self, omega: ArrayLike, index: int) -> Array:
        w = read_float_array(omega, "the frequencies").ravel()
        if not np.all((w >= 0) & (w <= np.pi / self.dt * (1 + 1e-9))):
            raise ArgumentError(
                f"frequencies lie between 0 and pi / dt = {np.pi / self.dt:g} rad/s: choose one of these."
            )
        k = self._check_time_index(index)
        within = mask_states_on_input_output_path(self.a[k], self.b[k], self.c[k])
        a, b, c = self.a[k][np.ix_(within, within)], self.b[k][within], self.c[k][:, within]
        z = np.exp(1j * w * self.dt)[:, None, None]
        return np.asarray(
            c @ _solve_linear_systems(z * np.eye(len(a)) - a, np.broadcast_to(b, (w.size, *b.shape)))
        )

    def _check_time_index(self, index: int) -> int:
        k = read_integer(index, "the index of an instant", 0)
        if k >= self.times.size:
            raise ArgumentError(f"there is no instant {k}: the response has {self.times.size}, from 0 on.")
        return k

    def _require_controller_command_label(self, command: str) -> str:
        labels = self.commands.labels
        if command not in labels:
            raise ArgumentError(f"there is no command '{command}': give one of {', '.join(labels)}.")
        return command


def _solve_linear_systems(matrices: Array, columns: Array) -> Array:
    try:
        return np.asarray(np.linalg.solve(matrices, columns))
    except np.linalg.LinAlgError:
        raise _build_pole_on_axis_error() from None


def _build_pole_on_axis_error() -> ArgumentError:
    return ArgumentError(
        "the loop has a pole at one of the frequencies, as an integral or a constant has at 0: "
        "choose another frequency, for example 1e-6 rad/s."
    )


@limit_to_one_thread()
def loop_response(
    loop: ClosedLoop,
    *,
    x0: ArrayLike | Mapping[str, ArrayLike],
    tf: float,
    t0: float = 0.0,
    parameters: Mapping[str, ArrayLike] | None = None,
    at: Sequence[float] | None = None,
) -> LoopResponse:
    """Return the frequency response of a loop, linearised at instants of its nominal run and opened at its commands.

    Parameters
    ----------
    loop : ClosedLoop
        Loop without events and without sensors that are sampled every few control steps.
    x0, t0, tf, parameters
        Nominal run, as in `ClosedLoop.simulate`.
    at : sequence of float, optional
        Times, s; the control steps that contain them are used. Default: the first control step.

    Raises
    ------
    ArgumentError
        Times outside the run, events, slow sensors, or derivatives that are not finite.

    Examples
    --------
    >>> response = loop_response(loop, x0=[1.0, 0.0], tf=8.0)
    >>> print(response.is_stable(), f"{response.disk_margins[0]:.2f}")
    True 1.24
    """
    require_type(loop, ClosedLoop, "the argument of loop_response()", "give a ClosedLoop")
    for sensor in loop.sensors:
        if isinstance(sensor, ZeroOrderHold) and round(sensor.period / loop.dt) > 1:
            raise ArgumentError(
                f"'{sensor.name}' is sampled every {sensor.period:g} s: a loop of two rates has no frequency response; "
                "remove it, or use its period as dt of the loop."
            )
    opened = replace(loop, actuators=(_CommandPerturbation(_PROBE), *loop.actuators))
    compiled_loop = opened.compile(x0, t0=t0, tf=tf, parameters=parameters)
    times = read_float_array(
        [compiled_loop.times[0]] if at is None else at, "the times of loop_response()"
    ).ravel()
    begin, end = compiled_loop.times[[0, -1]]
    if not times.size or not np.all((times >= begin) & (times < end)):
        raise ArgumentError(f"the run lasts from {begin:g} s to {end:g} s: give times of it, before its end.")
    wanted = np.unique(np.searchsorted(compiled_loop.times, times * (1 + 1e-12) + 1e-12, "right") - 1)
    columns = list(range(compiled_loop.layout.size)[compiled_loop.layout.slice(f"{_PROBE}.d")])
    linearization = Linearization(compiled_loop, opened.wiring, columns)
    rows = linearization.linearised_output_layout.split_vector_by_name(
        np.arange(linearization.linearised_output_layout.size)
    )["commands"]
    found = []
    X = linearization.differentiate_initial_loop_state()[0]
    for k, step in enumerate(linearization.linearize_control_steps(X)):
        if k in wanted:
            found.append((step.a, step.h, step.c[rows]))
        if k == wanted[-1]:
            break
        X = step.X_next
    a, b, c = (np.stack(parts) for parts in zip(*found, strict=True))
    return LoopResponse(compiled_loop.times[wanted], a, b, c, opened.dt, compiled_loop.commands)
