r"""Gain schedule: regulators designed at operating points, interpolated by measured scheduling variables.

At operating points :math:`(x_i, u_i)`, one per point of a grid of scheduling variables :math:`\sigma`, the
linear-quadratic gain K of the frozen linear plant is found; in flight

.. math:: u = u_{ff}(t) - \sum_i w_i(\sigma(x)) \, K_i \, e(x, x_{ref}(t)),

with the weights w of multilinear interpolation. Stability of the frozen loops does not imply that of a loop whose
schedule moves as fast as its errors. Scheduling states that no control moves are exogenous and are not fed back.

Source: W. J. Rugh, J. S. Shamma, Research on gain scheduling, Automatica 36 (2000) 1401-1425, section 3.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import expect, read_numbers, read_positive
from gnc_opt.arrays import Array
from gnc_opt.control.controller import Controller, initial_state_function, law
from gnc_opt.control.design_report import DesignReport, ReportEntry
from gnc_opt.control.dropout import with_dropout_handling
from gnc_opt.control.error_dynamics import ErrorDynamics
from gnc_opt.control.feedforward import ReferenceSchedule, reference_signals
from gnc_opt.control.quadratic_cost import QuadraticCost, Weight, read_cost
from gnc_opt.control.reference import Reference, read_plant
from gnc_opt.control.riccati import require_stabilizable, steady
from gnc_opt.control.sampled_data import SampledStep, continuous_poles, sample
from gnc_opt.environment import one_thread
from gnc_opt.errors import ArgumentError, DesignError, shown, unknown_name
from gnc_opt.model.model import Model
from gnc_opt.model.variables import Layout, as_point

OperatingPoint: TypeAlias = Callable[..., tuple[ArrayLike, ArrayLike]]
"""``at(*values)`` returns state (n_states,) and control (n_controls,) of the point with these scheduling variables."""


@one_thread()
def design_gain_schedule(
    model: Model,
    reference: Reference | ArrayLike,
    *,
    over: Mapping[str, ArrayLike],
    at: OperatingPoint,
    Q: Weight,
    R: Weight,
    dt: float,
) -> Controller:
    """Return a regulator with gains interpolated between operating points by measured scheduling variables.

    Parameters
    ----------
    model : Model
    reference : Reference or array (n_states,)
        States and feedforward to follow; for a state, the equilibrium there with its control.
    over : mapping
        Grid of each scheduling variable, ``{"speed": [20.0, 30.0, 45.0]}``: a scalar state or output that
        depends on no control; increasing.
    at : callable
        Returns the state and control at one value of each scheduling variable, also between grid points.
    Q, R : weight
        As in `design_lqr`, the same at each point.
    dt : float
        Control step, s.

    Returns
    -------
    Controller
        Signals ``<state>_ref``, ``<control>_ff``. `explain` shows the slowest frozen pole.

    Raises
    ------
    DesignError
        A point is not stabilisable, or a frozen loop between the points is unstable: refine the grid.
    ArgumentError, UnknownNameError
        Grids that do not increase, variables that are no scalar state or output, points of another shape.

    Examples
    --------
    >>> law = design_gain_schedule(cart, [0.0, 0.0], over={"v": [-1, 1]}, at=lambda v: ([0, v], [0]), Q=1, R=1, dt=0.1)
    >>> u, _ = law(0.0, [1.0, 0.5])
    >>> print(np.round(u, 3))
    [-1.736]
    """
    reference = read_plant(model, reference, "design_gain_schedule")
    deviation, cost = ErrorDynamics(model), read_cost(model, Q, R, None)
    grids = _grids(over)
    if not callable(at):
        raise ArgumentError(
            f"at of design_gain_schedule() is {shown(at)}: give a function of the grid's variables."
        )
    t, x = ca.SX.sym("t"), ca.SX.sym("x", model.states.size)
    variables = [_variable(deviation, name, t, x) for name in grids]
    given = _given(model, x, ca.vertcat(*variables))
    points = _Points(deviation, cost, at, read_positive(dt, "the control step dt"), given)
    if not points.steered.size:
        raise DesignError(f"no control moves a state of model '{model.name}': there is nothing to feed back.")
    corners = list(itertools.product(*grids.values()))
    gains = [points.gain(values) for values in corners]
    facts = _facts(points, grids, corners, gains)
    r = ca.SX.sym("r", x.numel() + model.controls.size)
    x_ref, u_ff = r[: x.numel()], r[x.numel() :]
    weights = [_weights(grid, value) for grid, value in zip(grids.values(), variables, strict=True)]
    gain = ca.SX.zeros(*gains[0].shape)
    for each, values in zip(itertools.product(*weights), gains, strict=True):
        weight = each[0]
        for more in each[1:]:
            weight = weight * more
        gain = gain + weight * ca.DM(values)
    nothing = ca.SX.sym("z", 0)
    return with_dropout_handling(
        Controller(
            name="gain schedule",
            step=law(t, x, r, nothing, u_ff - gain @ deviation.expression(x, x_ref), nothing),
            start=initial_state_function(t, x, r, ca.SX(0, 1)),
            states=model.states,
            commands=model.controls,
            signals=reference_signals(reference),
            memory=Layout("memory"),
            schedule=ReferenceSchedule(reference),
            dt=points.dt,
            span=(reference.initial_time, reference.final_time),
            explanation=DesignReport(
                f"gain schedule of '{model.name}' over {', '.join(grids)}", tuple(facts)
            ),
        )
    )


@dataclass(frozen=True, eq=False)
class _Points:
    """Operating points: their sampled plants and gains, of the errors of states that are not ``given``."""

    deviation: ErrorDynamics
    cost: QuadraticCost
    at: OperatingPoint
    dt: float
    given: tuple[str, ...]

    @property
    def steered(self) -> Array:
        """Places of the errors that are fed back."""
        errors = self.deviation.errors
        kept = np.ones(errors.size, dtype=bool)
        for name in self.given:
            kept[errors.slice(name)] = False
        return np.asarray(np.flatnonzero(kept))

    def held(self, values: tuple[float, ...]) -> SampledStep:
        """Return plant and cost over a control step."""
        (a, b), (q, r, n), kept = self.plant(values), self.cost, self.steered
        square = np.ix_(kept, kept)
        return sample(a[square], b[kept], q[square], r, n[kept], self.dt)

    def plant(self, values: tuple[float, ...]) -> tuple[Array, Array]:
        """Return A and B of all errors, continuous."""
        model, where = self.deviation.model, _where(values)
        found = self.at(*values)
        if not isinstance(found, tuple) or len(found) != 2:
            raise ArgumentError(
                f"at() of design_gain_schedule() returns {shown(found)}: write (state, control)."
            )
        x, u = found
        state = as_point(x, model.states.size, f"the state {where}", ArgumentError)
        control = as_point(u, model.controls.size, f"the control {where}", ArgumentError)
        a, b = self.deviation.linearize(0.0, state, control)
        if not (np.all(np.isfinite(a)) and np.all(np.isfinite(b))):
            raise DesignError(f"the plant {where} has no finite linearisation: move the grid, or the point.")
        return a, b

    def gain(self, values: tuple[float, ...]) -> Array:
        """Return K (n_controls, n_errors)."""
        (a, b), kept = self.plant(values), self.steered
        labels = tuple(self.deviation.errors.labels[i] for i in kept)
        gain = np.zeros((b.shape[1], a.shape[0]))
        try:
            require_stabilizable(a[np.ix_(kept, kept)], b[kept], labels)
            held = self.held(values)
            gain[:, kept] = steady(held.a, held.b, held.q, held.r, held.n, labels, sampled=True).gain
        except DesignError as error:
            raise DesignError(f"{_where(values)}: {error}") from error
        return gain

    def slowest(self, values: tuple[float, ...], gain: Array) -> float:
        """Return the largest real part of the frozen loop's poles, 1/s."""
        held = self.held(values)
        closed = held.a - held.b @ gain[:, self.steered]
        return float(np.max(continuous_poles(np.linalg.eigvals(closed), self.dt).real))


def _given(model: Model, x: ca.SX, scheduling: ca.SX) -> tuple[str, ...]:
    """Return the states behind scheduling variables, expressions of x, that no control moves, however indirectly."""
    _, states, controls, _ = model.arguments()
    f = model.derivative()
    among, by = (np.asarray(ca.DM(ca.jacobian_sparsity(f, v), 1).full()) > 0 for v in (states, controls))
    moved, behind = by.any(axis=1), np.array(ca.which_depends(scheduling, x, 1, False))
    for _ in range(moved.size):
        moved, behind = moved | among[:, moved].any(axis=1), behind | among[behind].any(axis=0)
    alone = behind & ~moved
    return tuple(name for name in model.states.names if alone[model.states.slice(name)].all())


def _facts(
    points: _Points, grids: dict[str, Array], corners: list[tuple[float, ...]], gains: list[Array]
) -> list[ReportEntry]:
    """Return the properties of the frozen loops at the points and half way between them."""
    shape = [grid.size for grid in grids.values()]
    table = np.reshape(gains, (*shape, *gains[0].shape))
    middles, between = [], []
    for cell in itertools.product(*(range(n - 1) for n in shape)):
        middles.append(
            tuple(float(0.5 * (g[i] + g[i + 1])) for g, i in zip(grids.values(), cell, strict=True))
        )
        between.append(np.mean(table[tuple(slice(i, i + 2) for i in cell)], axis=tuple(range(len(shape)))))
    at_points = max(points.slowest(v, k) for v, k in zip(corners, gains, strict=True))
    poles = [points.slowest(v, k) for v, k in zip(middles, between, strict=True)]
    worst = int(np.argmax(poles))
    if not poles[worst] < 0:
        raise DesignError(
            f"{_where(middles[worst])} the interpolated gain leaves a pole at {poles[worst]:.3g} 1/s: "
            "give the grid more points there."
        )
    stability = "frozen, real part"
    given = (
        [ReportEntry("taken as given", ", ".join(points.given), "", "no control moves them")]
        if points.given
        else []
    )
    return [
        ReportEntry("operating points", len(corners)),
        *given,
        ReportEntry("slowest pole at the points", at_points, "1/s", stability),
        ReportEntry(
            "slowest pole between them", poles[worst], "1/s", f"{stability}, {_where(middles[worst])}"
        ),
    ]


def _grids(over: Mapping[str, ArrayLike]) -> dict[str, Array]:
    expect(over, Mapping, "over of design_gain_schedule()", 'write {"speed": [20.0, 30.0]}')
    grids = {name: read_numbers(values, f"the grid of '{name}'") for name, values in over.items()}
    for name, grid in grids.items():
        if grid.ndim != 1 or grid.size < 2 or not np.all(np.diff(grid) > 0) or not np.all(np.isfinite(grid)):
            raise ArgumentError(f"the grid of '{name}' does not increase: give two finite numbers or more.")
    if not grids:
        raise ArgumentError('over names no scheduling variable: write {"speed": [20.0, 30.0]}.')
    return grids


def _variable(deviation: ErrorDynamics, name: str, t: ca.SX, x: ca.SX) -> ca.SX:
    """Return a scheduling variable as an expression of the measured state."""
    model = deviation.model
    if name in model.states:
        found = x[model.states.slice(name)]
    elif name in model.outputs:
        found = deviation.output(name, t, x)
    else:
        names = [*model.states.names, *model.outputs.names]
        raise unknown_name("state or output", name, f"model '{model.name}'", names)
    if found.numel() != 1:
        raise ArgumentError(f"'{name}' has {found.numel()} components: schedule over an output of one.")
    return found


def _weights(grid: Array, value: ca.SX) -> list[ca.SX]:
    """Return the weights of linear interpolation, one per point, of a value held within the grid."""
    held = ca.fmin(ca.fmax(value, grid[0]), grid[-1])
    weights = []
    for i, point in enumerate(grid):
        sides = [ca.SX(1)]
        if i > 0:
            sides.append((held - grid[i - 1]) / (point - grid[i - 1]))
        if i < grid.size - 1:
            sides.append((grid[i + 1] - held) / (grid[i + 1] - point))
        least = sides[0]
        for side in sides[1:]:
            least = ca.fmin(least, side)
        weights.append(ca.fmax(least, 0))
    return weights


def _where(values: tuple[float, ...]) -> str:
    return f"at the operating point ({', '.join(f'{v:g}' for v in values)})"
