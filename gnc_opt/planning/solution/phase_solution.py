"""PhaseSolution: numerical solution of one phase, evaluable at any time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import StrictAttributes, read_float_array, read_integer
from gnc_opt.array_types import Array
from gnc_opt.errors import unknown_name_error
from gnc_opt.model.model_variables import Layout, Variable
from gnc_opt.model.split_and_magnitude_direction_controls import ComposedControl, VectorControl
from gnc_opt.model.tabular_export_and_csv_import import TabularData
from gnc_opt.numerical_tolerances import SAME_TIME
from gnc_opt.planning.problem.angle_valued_controls import UnboundedAngles
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.solution.piecewise_polynomial import (
    PiecewisePolynomial,
    SaturatedControl,
    Side,
    subdivide_intervals,
)
from gnc_opt.planning.transcription.collocation_families import Scheme
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.planning.transcription.quadrature import CollocationRule, get_collocation_rule

SignalSource: TypeAlias = Callable[[ArrayLike, Side], Array]
"""Values of all rows at times, by side."""


def drop_singleton_axes(values: Array, t: ArrayLike) -> Array | float:
    """Return rows of a quantity at times t, without the axis of a single row; a number at a single time."""
    if values.shape[0] > 1:
        return values
    return float(values[0]) if np.ndim(t) == 0 else values[0]


@dataclass(frozen=True)
class Signal:
    """Named quantity over time.

    ``signal(t)`` returns a float for a scalar quantity at one time; else an array: (n,) at one time, (n_times,) for a
    scalar quantity, (n, n_times). ``side`` selects the left or right limit at a segment boundary.

    Examples
    --------
    >>> speed = solution.state("v")
    >>> print(f"{speed(1.0):.6f} {speed.unit}")
    -1.000000 m/s
    """

    name: str
    unit: str
    labels: tuple[str, ...]
    source: SignalSource
    rows: slice

    def __call__(self, t: ArrayLike, side: Side = "right") -> Array | float:
        """Return the value at time t (s)."""
        return drop_singleton_axes(self.source(t, side)[self.rows], t)


@dataclass(frozen=True, eq=False)
class PhaseSolution(StrictAttributes):
    """States, controls, costates and multipliers of one phase.

    Multipliers have the sign of L = J + multiplier * (constraint): >= 0 at an upper, <= 0 at a lower limit. Path and
    bound multipliers at collocation points are densities in time (multiplier per second).

    Attributes
    ----------
    name : str
    scheme : {"LG", "LGR", "LGL"}
    mesh : Mesh
    initial_time, final_time : float
        s.
    states, controls, model_parameters : Layout
    path_labels, integral_labels : tuple of str
    x, u, lam : PiecewisePolynomial
        States, controls and costates as the polynomials of the scheme.
    lam_start, lam_end : array (n_states, K)
        Costates at the start and end of each segment: one-sided limits of ``lam`` from the program's rows (for LGR and
        LGL along active segments from the points; see `gnc_opt.planning.solution.costates`).
    point_costates : array (n_states, N)
        Costates at the collocation points for which the controls minimise H: for LG those of ``lam``, for LGR and LGL
        of lower order.
    path_multipliers : array (n_paths, N)
    state_multipliers : array (n_states, N)
    control_multipliers : array (n_controls, N)
    state_impulses : array (n_states, K + 1)
        Multipliers of state bounds (and fixed end values) at segment boundaries: jumps of the costate.
    time_multipliers : array (2,)
        Multipliers of the bounds on initial and final time (0 for fixed times).
    duration_multiplier : float
    integrals, integral_weights : array (n_integrals,)
        Values, and dJ/dI, the weights of the integrands in the Hamiltonian.
    parameters : array (n_model_parameters,)
        Values of the model parameters, including optimised ones.
    state_bounds, control_bounds, path_bounds, initial_bounds, final_bounds : Interval
    initial_time_bounds, final_time_bounds, duration_bounds : Interval
    composed_controls : tuple of ComposedControl
        Declared controls that are composed of two of ``controls``.
    turns : UnboundedAngles or None
        Range of the angular controls returned by name; ``u`` is continuous across turns.

    Examples
    --------
    >>> leg = solution.phase("leg")
    >>> print(f"{leg.initial_time:.1f} to {leg.final_time:.6f} s, {leg.state('v')(1.0):.6f} m/s at 1 s")
    0.0 to 2.000000 s, -1.000000 m/s at 1 s
    """

    name: str
    scheme: Scheme
    mesh: Mesh
    initial_time: float
    final_time: float
    states: Layout
    controls: Layout
    model_parameters: Layout
    path_labels: tuple[str, ...]
    integral_labels: tuple[str, ...]
    x: PiecewisePolynomial
    u: PiecewisePolynomial
    lam: PiecewisePolynomial
    lam_start: Array
    lam_end: Array
    point_costates: Array
    path_multipliers: Array
    state_multipliers: Array
    control_multipliers: Array
    state_impulses: Array
    time_multipliers: Array
    duration_multiplier: float
    integrals: Array
    integral_weights: Array
    parameters: Array
    state_bounds: Interval
    control_bounds: Interval
    path_bounds: Interval
    initial_bounds: Interval
    final_bounds: Interval
    initial_time_bounds: Interval
    final_time_bounds: Interval
    duration_bounds: Interval
    composed_controls: tuple[ComposedControl, ...] = ()
    turns: UnboundedAngles | None = None

    @cached_property
    def collocation_rules(self) -> tuple[CollocationRule, ...]:
        """The collocation rule of each segment."""
        return tuple(get_collocation_rule(self.scheme, n) for n in self.mesh.degrees)

    @property
    def duration(self) -> float:
        """final_time - initial_time, s."""
        return self.final_time - self.initial_time

    @property
    def vector_controls(self) -> tuple[VectorControl, ...]:
        """Composed controls that are products of magnitude and direction."""
        return tuple(c for c in self.composed_controls if isinstance(c, VectorControl))

    @property
    def breaks(self) -> Array:
        """Times of the segment boundaries, shape (K + 1,)."""
        return self.x.breaks

    @property
    def endpoint_arguments(self) -> list[Array | float]:
        """Initial and final state, initial and final time, integrals, parameters: arguments of end-point functions."""
        first, last = self.x(self.breaks[[0, -1]]).T
        return [first, last, self.initial_time, self.final_time, self.integrals, self.parameters]

    @cached_property
    def point_times(self) -> Array:
        """Times of the collocation points, shape (N,)."""
        left, width = self.breaks[:-1], np.diff(self.breaks)
        pieces = [left[k] + 0.5 * width[k] * (1 + r.points) for k, r in enumerate(self.collocation_rules)]
        return np.concatenate(pieces)

    @cached_property
    def point_weights(self) -> Array:
        """Quadrature weights of the collocation points in s, shape (N,)."""
        weights = np.concatenate([r.weights for r in self.collocation_rules])
        return weights * np.repeat(0.5 * np.diff(self.breaks), self.mesh.degrees)

    def sample_at_collocation_points(self, signal: Callable[[Array, Side], Array]) -> Array:
        """Return a signal at the collocation points, with the limit from inside each segment: (n, N)."""
        at_end = np.concatenate([r.points == 1.0 for r in self.collocation_rules])
        return np.where(at_end, signal(self.point_times, "left"), signal(self.point_times, "right"))

    @cached_property
    def point_trajectory(self) -> tuple[Array, Array, Array]:
        """Times (N,), states (n, N) and controls (m, N) at the collocation points."""
        return self.point_times, self.sample_at_collocation_points(self.x), np.hstack(self.u.values)

    @cached_property
    def applied(self) -> SaturatedControl:
        """Applied controls, within the bounds."""
        return SaturatedControl(self.u, self.control_bounds, self.collocation_rules)

    @cached_property
    def path_multiplier(self) -> PiecewisePolynomial:
        """Densities of the path multipliers as piecewise polynomials."""
        return self.interpolate_point_values(self.path_multipliers)

    @cached_property
    def state_multiplier(self) -> PiecewisePolynomial:
        """Densities of the state bound multipliers as piecewise polynomials."""
        return self.interpolate_point_values(self.state_multipliers)

    @cached_property
    def control_multiplier(self) -> PiecewisePolynomial:
        """Densities of the control bound multipliers as piecewise polynomials."""
        return self.interpolate_point_values(self.control_multipliers)

    def state(self, name: str) -> Signal:
        """Return a state over time."""
        return self._build_state_or_control_signal(name, self.states, self.x)

    def costate(self, name: str) -> Signal:
        """Return the costate of a state over time: dJ*/dx, per unit of the state."""
        signal = self._build_state_or_control_signal(name, self.states, self.lam)
        unit = f"1/({signal.unit})" if signal.unit else ""
        return Signal(f"lam_{name}", unit, signal.labels, self.lam, signal.rows)

    def control(self, name: str) -> Signal:
        """Return the collocation polynomial of a control (it may exceed its bounds between nodes)."""
        return self._build_control_signal(name, self.u)

    def saturated_control(self, name: str) -> Signal:
        """Return an applied control over time, within its bounds."""
        return self._build_control_signal(name, self.applied)

    def integral(self, name: str) -> float:
        """Return the value of a named integral."""
        if not isinstance(name, str) or name not in self.integral_labels:
            raise unknown_name_error("integral", name, f"phase '{self.name}'", self.integral_labels)
        return float(self.integrals[self.integral_labels.index(name)])

    def sample_times(self, per_segment: int = 10) -> Array:
        """Return times that divide each segment into equal parts (K * per_segment + 1,), s."""
        return subdivide_intervals(self.breaks, read_integer(per_segment, "per_segment", 1))

    def _build_control_signal(self, name: str, source: SignalSource) -> Signal:
        composed = next((control for control in self.composed_controls if control.name == name), None)
        value = partial(self._evaluate_control, composed, source)
        if composed is not None:
            variable = composed.variable
            return Signal(name, variable.unit, variable.labels, value, slice(None))
        if name in self.states and name not in self.controls:
            return self.state(name)  # a control with limited rate
        return self._build_state_or_control_signal(name, self.controls, value)

    def _evaluate_control(
        self, composed: ComposedControl | None, source: SignalSource, t: ArrayLike, side: Side
    ) -> Array:
        values = source(t, side)
        if composed is not None:
            part_values = (values[self.controls.slice(part)] for part in composed.parts)
            return np.asarray(composed.compose_control(*part_values))
        return values if self.turns is None else self.turns.wrap_angles(values)

    def _build_state_or_control_signal(self, name: str, layout: Layout, source: SignalSource) -> Signal:
        return Signal(name, layout[name].unit, layout[name].labels, source, layout.slice(name))

    def interpolate_point_values(self, values: Array) -> PiecewisePolynomial:
        """Return the polynomials through values (n, N) at the collocation points."""
        return interpolate_point_values(self.breaks, self.collocation_rules, values)


def interpolate_point_values(
    breaks: Array, rules: Sequence[CollocationRule], values: Array
) -> PiecewisePolynomial:
    """Return the polynomials through values (n, N) at the collocation points."""
    offsets = np.concatenate([[0], np.cumsum([r.n for r in rules])])
    pieces = tuple(values[:, offsets[k] : offsets[k + 1]] for k in range(len(rules)))
    return PiecewisePolynomial(breaks, tuple(r.points for r in rules), pieces)


def build_time_history(phase: PhaseSolution, times: ArrayLike | None = None) -> TabularData:
    """Return states, applied controls and costates by time; see `Solution.to_pandas`."""
    t = phase.sample_times() if times is None else np.atleast_1d(read_float_array(times, "the times"))
    x, lam = phase.x(t), phase.lam(t)
    states, controls = phase.states.variables, [*phase.controls.variables]
    controls += [control.variable for control in phase.composed_controls]
    columns = [(v, x[phase.states.slice(v.name)]) for v in states]
    columns += [(v, np.atleast_2d(phase.saturated_control(v.name)(t))) for v in controls]
    costates = [(v, phase.costate(v.name)) for v in states]
    columns += [(Variable(c.name, v.size, c.unit), lam[c.rows]) for v, c in costates]
    return TabularData(Variable("time", unit="s"), t, tuple(columns), {"phase": phase.name})


def truncate_phase_to_start_time(phase: PhaseSolution, time: float) -> PhaseSolution:
    """Return the part of a phase after a given time, with the state at that time as initial state.

    It solves the remaining problem (principle of optimality). Costates and multipliers are included; integrals and
    bounds are those of the whole phase. The time (s) is not before the start, and before the end.
    """
    slack = SAME_TIME * phase.duration
    first = int(np.searchsorted(phase.breaks[1:-1], time + slack, "right"))
    breaks = np.append(time, phase.breaks[first + 1 :])
    degrees = phase.mesh.degrees[first:]
    mesh = Mesh.at_times(breaks, degrees)
    remaining = replace(
        phase,
        mesh=mesh,
        initial_time=time,
        x=_truncate_signal(phase.x, first, breaks),
        u=_truncate_signal(phase.u, first, breaks),
        lam=_truncate_signal(phase.lam, first, breaks),
    )
    lam_start, impulses = phase.lam_start[:, first:].copy(), phase.state_impulses[:, first:].copy()
    lam_start[:, 0] = phase.lam(time)
    impulses[:, 0] = -lam_start[:, 0]  # fixed initial state: L = J + multiplier (x - x0), dJ/dx0 = lam
    return replace(
        remaining,
        lam_start=lam_start,
        lam_end=phase.lam_end[:, first:],
        point_costates=remaining.sample_at_collocation_points(phase.lam),
        path_multipliers=remaining.sample_at_collocation_points(phase.path_multiplier),
        state_multipliers=remaining.sample_at_collocation_points(phase.state_multiplier),
        control_multipliers=remaining.sample_at_collocation_points(phase.control_multiplier),
        state_impulses=impulses,
    )


def _truncate_signal(signal: PiecewisePolynomial, first: int, breaks: Array) -> PiecewisePolynomial:
    """Return the segments from ``first`` on, with the first one starting at the first break: the same polynomials."""
    left, right = signal.breaks[first], signal.breaks[first + 1]
    nodes = signal.nodes[first]
    times = breaks[0] + 0.5 * (breaks[1] - breaks[0]) * (1 + nodes)
    first_piece = PiecewisePolynomial(np.array([left, right]), (nodes,), (signal.values[first],))
    values = (first_piece(np.clip(times, left, right)), *signal.values[first + 1 :])
    return PiecewisePolynomial(breaks, signal.nodes[first:], values)
