"""Reference trajectory of a controller, and its residual in the model's dynamics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import ArrayLike, NDArray

from gnc_opt.argument_checks import StrictAttributes, read_float_array, require_type
from gnc_opt.array_types import GOLDEN_RATIO_FRACTION, Array
from gnc_opt.errors import ArgumentError, quote_value, suggest_similar_name, warn_user
from gnc_opt.model.model_variables import Layout, read_state_vector
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.model.trajectory_protocol import Trajectory, TrajectoryPhase
from gnc_opt.numerical_tolerances import ROUNDING, SAME_TIME, max_norm, replace_zeros_by_one

Signal: TypeAlias = Callable[[Array], Array]
"""Function from times (n,) to values (size, n)."""

_DYNAMICS_CHECK_TIMES = 24
"""Number of times at which the rates of a reference are compared with the model, over all its pieces."""
_STEP_SHARE = 1e-4
"""Interval of the state difference quotient, as a share of the piece."""
_DYNAMICS_CHECK_TOLERANCE = 1e-3
"""Residual of a rate above which a warning is issued, as a share of its terms."""


def describe_dynamics_residual(model: Model, x: Signal, u: Signal, edges: Array) -> str:
    """Return a description of the largest residual (state, time, value); "" if all are small."""
    lengths = np.diff(edges)
    pieces = np.unique(np.linspace(0, lengths.size - 1, _DYNAMICS_CHECK_TIMES).astype(int))
    each = -(-_DYNAMICS_CHECK_TIMES // pieces.size)
    share = 0.99 * (np.arange(1, each + 1) * GOLDEN_RATIO_FRACTION % 1.0)  # quasi-random
    times = (edges[pieces, None] + lengths[pieces, None] * share).ravel()
    h = _STEP_SHARE * np.repeat(lengths[pieces], each)
    first, last = x(times), x(times + h)
    rates = [model.f(t, x(t), u(t)) for t in (times, times + h / 2, times + h)]
    left = np.abs((last - first) / h - (rates[0] + 4 * rates[1] + rates[2]) / 6)  # Simpson's rule
    rounded = 8 * np.finfo(float).eps * (np.abs(first) + np.abs(last)) / h
    return _format_trim_residual(model, times, np.maximum(left - rounded, 0.0), first, u(times))


def _format_trim_residual(model: Model, times: Array, residual: Array, x: Array, u: Array) -> str:
    magnitude = np.abs(model.f(times, x, u)) + residual
    for j, t in enumerate(times):
        a, b = model.linearize(float(t), x[:, j], u[:, j])
        magnitude[:, j] += np.abs(a) @ np.abs(x[:, j]) + np.abs(b) @ np.abs(u[:, j])
    scale = np.max(magnitude, axis=1, keepdims=True)
    share = np.nan_to_num(residual / replace_zeros_by_one(scale))
    i, k = np.unravel_index(int(np.argmax(share)), share.shape)
    if not share[i, k] > _DYNAMICS_CHECK_TOLERANCE:
        return ""
    per_second = f"{model.states.units[i]} per second".strip()
    return (
        f"the rate of '{model.states.labels[i]}' differs by {residual[i, k]:.3g} {per_second} from the model's at t = "
        f"{times[k]:.4g} s, {100 * share[i, k]:.3g} % of the terms of its rate"
    )


Tail: TypeAlias = Literal["trim", "hold"]

TRIM_TOLERANCE = 1e-6
"""Largest state rate of an equilibrium with the best control (1/s), relative to max(1, largest state)."""

_NODES, _WEIGHTS = leggauss(8)  # for the mean control over a step without a jump


class Reference(StrictAttributes):
    """State and control reference over time, from a solution, from functions or constant.

    After ``final_time`` the reference stays at its final state with the ``tail`` control. All phases of a solution must
    have the same states and controls.

    Parameters
    ----------
    solution : Trajectory
        A solved `gnc_opt.Solution`; the reference uses its *applied* controls, which satisfy their bounds.
    tail : {"trim", "hold"}
        Control after ``final_time``: ``"trim"`` computes the control for which the final state is an equilibrium (least
        squares), ``"hold"`` keeps the final control.

    Raises
    ------
    ArgumentError
        The solution is not solved, its phases differ in states or controls, or ``tail`` is ``"trim"`` and the final
        state is not an equilibrium for any control.

    Examples
    --------
    >>> reference = go.Reference(solution)
    >>> print(f"{reference.final_time:.6f}", np.round(reference.x(1.0), 6))
    2.000000 [ 0.5 -1. ]
    """

    __slots__ = (
        "_breaks",
        "_tail",
        "_u",
        "_x",
        "controls",
        "final_time",
        "initial_time",
        "jumps",
        "model",
        "source",
        "states",
    )

    def __init__(self, solution: Trajectory, *, tail: Tail = "trim") -> None:
        require_type(solution, Trajectory, "the argument of Reference()", "write Reference(solve(problem))")
        phases = solution.trajectory_phases()
        _require_equal_phase_layouts(phases)
        self.source = f"solution of '{getattr(solution, 'problem_name', phases[0].name)}'"
        self._store_reference_time_functions(
            phases[0].model,
            [phase.x for phase in phases],
            [phase.u for phase in phases],
            [phase.initial_time for phase in phases] + [phases[-1].final_time],
            np.unique(np.concatenate([phase.jumps for phase in phases])),
            tail,
        )

    @classmethod
    def constant(cls, model: Model, x: ArrayLike, u: ArrayLike | None = None) -> Reference:
        """Return a constant reference.

        Parameters
        ----------
        model : Model
        x : array (n_states,)
        u : array (n_controls,), optional
            Constant control; default: the trim control of the state.
        """
        require_type(model, Model, "the model of a reference", "give the Model of the plant")
        state = read_state_vector(x, model.states.size, "the state of a constant reference", ArgumentError)
        control = (
            trim(model, 0.0, state)
            if u is None
            else read_state_vector(
                u, model.controls.size, "the control of a constant reference", ArgumentError
            )
        )
        return cls.from_functions(model, lambda _: state, lambda _: control, 0.0, 0.0, tail="hold")

    @classmethod
    def from_functions(
        cls,
        model: Model,
        x: Callable[[Any], ArrayLike],
        u: Callable[[Any], ArrayLike],
        initial_time: float,
        final_time: float,
        *,
        jumps: Sequence[float] = (),
        tail: Tail = "hold",
        vectorized: bool = False,
    ) -> Reference:
        """Return the reference of two functions of time.

        Parameters
        ----------
        model : Model
        x, u : callable
            Functions of time (s) that return states (n_states,) and controls (n_controls,).
        initial_time, final_time : float
            Time span, s.
        jumps : sequence of float
            Times at which the control jumps, s.
        tail : {"trim", "hold"}
            As in the class.
        vectorized : bool
            Whether the functions take times (n,) and return (n_states, n) and (n_controls, n); faster.

        Raises
        ------
        ArgumentError
            The times do not increase, or a function returns an invalid state or control.

        Warns
        -----
        ProblemWarning
            The states do not satisfy the model's dynamics; the message contains the largest residual found.
        """
        reference = cls.__new__(cls)
        reference.source = "functions of time"
        span = [float(initial_time), float(final_time)]
        if not (np.all(np.isfinite(span)) and span[0] <= span[1]):
            raise ArgumentError(
                f"a reference has no time span from {span[0]} s to {span[1]} s: give increasing times."
            )
        for function, kind in ((x, "states"), (u, "controls")):
            if not callable(function):
                raise ArgumentError(
                    f"the {kind} of a reference are {quote_value(function)}: give a function of time."
                )
        vectorize = _check_vectorized_time_function if vectorized else _vectorize_time_function
        reference._store_reference_time_functions(
            model,
            [vectorize(x, model.states)],
            [vectorize(u, model.controls)],
            span,
            np.unique([span[0], *jumps, span[1]]),
            tail,
        )
        if span[0] < span[1]:
            _warn_of_dynamics_residual(
                model, reference._x[0], reference._u[0], np.clip(reference.jumps, span[0], span[1])
            )
        return reference

    def _store_reference_time_functions(
        self,
        model: Model,
        x: list[Callable[[Array], Array]],
        u: list[Callable[[Array], Array]],
        breaks: list[float],
        jumps: Array,
        tail: Tail,
    ) -> None:
        if tail not in get_args(Tail):
            raise ArgumentError(
                f"a reference has no tail {quote_value(tail)}: {suggest_similar_name(str(tail), get_args(Tail))}"
            )
        self.model, self.states, self.controls = model, model.states, model.controls
        self._x, self._u, self._breaks = x, u, np.asarray(breaks, dtype=float)
        self.initial_time, self.final_time, self.jumps = float(breaks[0]), float(breaks[-1]), jumps
        end = self.final_time
        held = tail == "hold"
        self._tail = (
            self._evaluate_piecewise_reference(u, end, None) if held else trim(model, end, self.x(end))
        )

    def __repr__(self) -> str:
        return f"Reference({self.model.name!r}, {self.initial_time:g} s to {self.final_time:g} s)"

    @property
    def description(self) -> str:
        """Source and time span, for example "solution of 'transfer', 0 s to 2 s"."""
        if self.duration == 0.0:
            state = ", ".join(f"{value:.4g}" for value in self.x(self.final_time))
            return f"constant state ({state})"
        return f"{self.source}, {self.initial_time:.6g} s to {self.final_time:.6g} s"

    @property
    def duration(self) -> float:
        """Duration final_time - initial_time, s."""
        return self.final_time - self.initial_time

    @property
    def control_after_final_time(self) -> Array:
        """Control after ``final_time``, (n_controls,)."""
        return self._tail

    def x(self, t: ArrayLike) -> Array:
        """Return the states at time t (s): (n_states,) for a scalar, (n_states, n_times) for an array."""
        return self._evaluate_piecewise_reference(self._x, t, None)

    def u(self, t: ArrayLike) -> Array:
        """Return the controls at time t (s): (n_controls,) for a scalar, (n_controls, n_times) for an array."""
        return self._evaluate_piecewise_reference(self._u, t, self._tail)

    def mean_control(self, times: ArrayLike, dt: float) -> Array:
        """Return the mean control over the steps from ``times`` (n,) to ``times + dt``, (n_controls, n)."""
        starts = np.atleast_1d(read_float_array(times, "the times of a reference"))
        owners, left, right = _split_steps_at_reference_jumps(
            starts, dt, np.unique(np.concatenate([self.jumps, self._breaks]))
        )
        at = 0.5 * (left + right)[:, None] + 0.5 * (right - left)[:, None] * _NODES
        means = (
            self.u(at.ravel()).reshape(self.controls.size, *at.shape) @ _WEIGHTS * (0.5 * (right - left) / dt)
        )
        total = np.zeros((self.controls.size, starts.size))
        np.add.at(total.T, owners, means.T)
        return total

    def _evaluate_piecewise_reference(
        self, parts: list[Callable[[Array], Array]], t: ArrayLike, tail: Array | None
    ) -> Array:
        """Return values (n, N) at times, after the end those of ``tail`` (n,) if given."""
        times = np.atleast_1d(read_float_array(t, "the time of a reference"))
        slack = SAME_TIME * max(self.duration, 1.0)
        if np.any(times < self.initial_time - slack):
            raise ArgumentError(
                f"the reference runs from {self.initial_time:g} s to {self.final_time:g} s, not at "
                f"{quote_value(float(np.min(times)))} s: choose a time in this interval."
            )
        within = np.clip(times, self.initial_time, self.final_time)
        if len(parts) == 1:
            values = np.array(parts[0](within))
        else:
            part = np.clip(np.searchsorted(self._breaks, within, "right") - 1, 0, len(parts) - 1)
            values_by_part = []
            for k in np.unique(part):
                in_part, span = part == k, self._breaks[k : k + 2]
                values_by_part.append((in_part, parts[int(k)](np.clip(within[in_part], *span))))
            values = np.empty((values_by_part[0][1].shape[0], times.size))
            for in_part, value in values_by_part:
                values[:, in_part] = value
        if tail is not None:
            values[:, times > self.final_time + slack] = tail[:, None]
        return values if np.ndim(t) else values[:, 0]


def read_design_reference(model: Model, reference: Reference | ArrayLike, designer: str) -> Reference:
    """Return the reference of a design; a state array gives a constant reference."""
    require_type(model, Model, f"the plant of {designer}()", "give the Model to control")
    return reference if isinstance(reference, Reference) else Reference.constant(model, reference)


def trim(model: Model, t: float, x: ArrayLike) -> Array:
    """Return the trim control (n_controls,), for which the state x is an equilibrium at time t.

    Solves ``f(t, x, u) = 0`` for u by Newton's method in the least-squares sense, starting at u = 0.

    Parameters
    ----------
    model : Model
    t : float
        s.
    x : array (n_states,)

    Raises
    ------
    ArgumentError
        No trim control exists; the message names the state with the largest rate.

    Examples
    --------
    >>> lift = go.Model("lift")
    >>> h, w = lift.state("h", unit="m"), lift.state("w", unit="m/s")
    >>> thrust = lift.control("thrust", unit="N")
    >>> lift.ode({h: w, w: thrust / 2.0 - 9.81})
    >>> print(trim(lift, 0.0, [10.0, 0.0]))
    [19.62]
    """
    state = read_state_vector(x, model.states.size, "the state to rest at", ArgumentError)
    u = np.zeros(model.controls.size)
    for _ in range(20):
        step = np.linalg.lstsq(model.linearize(t, state, u)[1], -model.f(t, state, u), rcond=None)[0]
        u = u + step
        if max_norm(step) <= ROUNDING * (1 + max_norm(u)):
            break
    residual = np.abs(model.f(t, state, u))
    worst = int(np.argmax(residual))
    if residual[worst] > TRIM_TOLERANCE * max(max_norm(state), 1.0):
        raise ArgumentError(
            f"no control keeps the final state of '{model.name}' at rest: '{model.states.labels[worst]}' still moves "
            f'at {residual[worst]:.3g} per second; give the reference tail="hold".'
        )
    return u


def _warn_of_dynamics_residual(
    model: Model, x: Callable[[Array], Array], u: Callable[[Array], Array], edges: Array
) -> None:
    residual = describe_dynamics_residual(model, x, u, np.unique(edges))
    if residual:
        warn_user(
            f"the reference does not satisfy the dynamics of '{model.name}': {residual}; give consistent functions x "
            "and u, or accept a tracking error with every controller."
        )


def _split_steps_at_reference_jumps(
    starts: Array, dt: float, marks: Array
) -> tuple[NDArray[np.intp], Array, Array]:
    """Return the pieces of steps between marks: index of the step, start and end of each piece."""
    first, behind = np.searchsorted(marks, starts, "right"), np.searchsorted(marks, starts + dt, "left")
    counts = np.maximum(behind - first, 0) + 1
    owners = np.repeat(np.arange(starts.size), counts)
    place = np.arange(owners.size) - np.repeat(np.cumsum(counts) - counts, counts)
    ends = np.append(marks, np.inf)  # the last piece of a step ends before the next mark
    mark = first[owners] + place
    left = np.where(place > 0, marks[mark - 1], starts[owners])
    right = np.where(place < counts[owners] - 1, ends[mark], starts[owners] + dt)
    return owners, left, right


def _vectorize_time_function(
    function: Callable[[float], ArrayLike], layout: Layout
) -> Callable[[Array], Array]:
    def evaluate_function_at_each_time(times: Array) -> Array:
        what = f"the {layout.kind}s of a reference"
        rows = [read_state_vector(function(float(t)), layout.size, what) for t in times]
        return _require_finite_reference(np.array(rows).T, times, layout)

    return evaluate_function_at_each_time


def _check_vectorized_time_function(
    function: Callable[[Array], ArrayLike], layout: Layout
) -> Callable[[Array], Array]:
    def evaluate_vectorized_function(times: Array) -> Array:
        values = np.asarray(function(times), dtype=float)
        if values.shape != (layout.size, times.size):
            raise ArgumentError(
                f"the {layout.kind}s of a vectorized reference have the shape {values.shape} at {times.size} times, "
                f"not {(layout.size, times.size)}: return a column for every time, or leave out vectorized."
            )
        return _require_finite_reference(values, times, layout)

    return evaluate_vectorized_function


def _require_finite_reference(values: Array, times: Array, layout: Layout) -> Array:
    """Return the reference values (size, n); raise `ArgumentError` if one is not finite."""
    finite = np.all(np.isfinite(values), axis=0)
    if not np.all(finite):
        raise ArgumentError(
            f"the {layout.kind}s of a reference are not finite at {times[np.argmin(finite)]:g} s: correct the function."
        )
    return values


def _require_equal_phase_layouts(phases: Sequence[TrajectoryPhase]) -> None:
    first = phases[0]
    names = (first.model.states.labels, first.model.controls.labels)
    for phase in phases[1:]:
        if (phase.model.states.labels, phase.model.controls.labels) != names:
            raise ArgumentError(
                f"phases '{first.name}' and '{phase.name}' have different states or controls: "
                "use a reference for each."
            )
