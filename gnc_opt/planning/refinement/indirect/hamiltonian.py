r"""The Hamiltonian boundary-value problem of a smooth optimal control problem, stated as a problem of its own.

With :math:`\tilde\Phi = \Phi + \nu^T \psi` (minimised cost and active boundary constraints) and weights
:math:`w = \partial\tilde\Phi / \partial I` of the integrals, an optimal trajectory without active bounds or path
constraints solves

.. math::
    \dot x = f, \quad \dot\lambda = -H_x, \quad 0 = H_u, \qquad
    \lambda(t_0) = -\tilde\Phi_{x_0}, \quad \lambda(t_f) = \tilde\Phi_{x_f}, \quad
    H(t_0) = \tilde\Phi_{t_0}, \quad H(t_f) = -\tilde\Phi_{t_f}, \quad
    \tilde\Phi_q + \int H_q\,dt = 0

(each end condition where the state, time or parameter q is free). It is written down here with the package's own
`Model` and `Problem`: x and :math:`\lambda` are states, :math:`H_u = 0` a path equality, :math:`\nu` and w parameters,
and the end conditions boundary constraints. So there is one collocation in the package, and several phases, free times,
integrals and parameters come for nothing. The result is square, and Newton's method solves it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array, Mask
from gnc_opt.model.model import Model
from gnc_opt.planning.problem.functions import end_function, phase_functions
from gnc_opt.planning.problem.interval import Interval, intersect
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.extract import model_parameters
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.tolerances import TINY

HELD_LIMIT_TOLERANCE = 1e-7
"""A boundary value, time or parameter this near to a limit (relative to its size) is held there."""


@dataclass(frozen=True)
class PhaseLimits:
    """Held end values (n_states,) and times (2,) of a phase; NaN where they are free."""

    initial: Array
    final: Array
    times: Array


@dataclass(frozen=True)
class HeldLimits:
    """Values at which boundary constraints, parameters and ends of phases are held; NaN where they are not."""

    phases: Mapping[str, PhaseLimits]
    constraints: Array
    parameters: Array


def active_limits(solution: Solution) -> HeldLimits:
    """Return which limits are active."""
    problem = solution.problem
    assert problem is not None, "solve_indirect refuses solutions without a problem"
    phases = {}
    for name, leg in solution.phases.items():
        sizes = np.max(np.abs(np.hstack(leg.x.values)), axis=1)
        first, last = leg.x(leg.breaks[0]), leg.x(leg.breaks[-1], "left")
        times = [
            _held(box, np.array([value]), np.array([max(leg.duration, abs(value))]))[0]
            for box, value in (
                (leg.initial_time_bounds, leg.initial_time),
                (leg.final_time_bounds, leg.final_time),
            )
        ]
        phases[name] = PhaseLimits(
            _held(intersect(leg.initial_bounds, leg.state_bounds), first, sizes),
            _held(intersect(leg.final_bounds, leg.state_bounds), last, sizes),
            np.asarray(times),
        )
    constraints, parameters = solution.constraint_values, solution.parameter_values
    return HeldLimits(
        phases,
        _held(problem.constraint_interval(), constraints, np.maximum(1.0, np.abs(constraints))),
        _held(problem.parameter_interval(), parameters, np.maximum(TINY, np.abs(parameters))),
    )


def _held(box: Interval, values: Array, sizes: Array) -> Array:
    """The limit where there is one and the value is at it, else NaN."""
    held = np.full(values.shape, np.nan)
    for limit in (box.lower, box.upper):
        near = box.fixed | (np.abs(values - limit) <= HELD_LIMIT_TOLERANCE * sizes)
        held = np.where(np.isfinite(limit) & near, limit, held)
    return held


def hamiltonian_problem(solution: Solution, limits: HeldLimits) -> Problem:
    """State the boundary-value problem.

    Returns
    -------
    Problem
        Phases of the same names with states ``x``, ``lam`` and control ``u``; parameters ``q`` and ``nu`` and, per
        phase, ``w_<phase>`` (weights of its integrals), ``first_<phase>`` and ``last_<phase>`` (controls at free
        initial and final times), all only where there are such. Its cost is zero.
    """
    original = solution.problem
    assert original is not None, "solve_indirect refuses solutions without a problem"
    problem = Problem(f"Hamiltonian boundary-value problem of {original.name}")
    q = _parameter(problem, "q", solution.parameter_values)
    nu = _parameter(problem, "nu", solution.constraint_multipliers)
    legs = {name: _Leg(problem, original, leg, q) for name, leg in solution.phases.items()}
    arguments = [argument for leg in legs.values() for argument in leg.ends]
    _, constraints, *gradients = end_function(original)(*arguments, q, nu)
    q_rows = gradients[-1]
    for k, leg in enumerate(legs.values()):
        leg.close(limits.phases[leg.name], gradients[5 * k : 5 * k + 5])
        q_rows += leg.parameter_integrals
    held = np.isfinite(limits.constraints) & _can_move(constraints, legs.values(), limits, q)
    _constrain(problem, "boundary constraints", constraints, nu, limits.constraints, held)
    _constrain(problem, "parameters", q, q_rows, limits.parameters, np.isfinite(limits.parameters))
    problem.minimize(0.0)
    return problem


def _parameter(problem: Problem, name: str, values: Array) -> Any:
    return problem.parameter(name, values.size, guess=values) if values.size else ca.SX(0, 1)


def _constrain(problem: Problem, name: str, held: Any, otherwise: Any, limits: Array, active: Any) -> None:
    """One equation per component: the held quantity at its limit, or else the other one at zero."""
    for i, here in enumerate(active):
        problem.constrain(
            f"{name} {i + 1}", held[i] if here else otherwise[i], equals=float(limits[i]) if here else 0.0
        )


def _can_move(constraints: Any, legs: Iterable[_Leg], limits: HeldLimits, q: Any) -> Mask:
    """Boundary constraints (n,) that involve something free; of others (joined fixed times) nu is arbitrary, 0."""
    free = [q[np.flatnonzero(np.isnan(limits.parameters)).tolist()]]
    for leg in legs:
        values, here = leg.ends, limits.phases[leg.name]
        free += [
            end[np.flatnonzero(np.isnan(held)).tolist()]
            for end, held in zip(values[:2], (here.initial, here.final), strict=True)
        ]
        free += [time for time, held in zip(values[2:4], here.times, strict=True) if np.isnan(held)]
        free.append(values[4])
    jacobian = ca.jacobian(constraints, ca.vertcat(*free))
    moves = np.zeros(constraints.shape[0], dtype=bool)
    moves[jacobian.sparsity().row()] = True
    return moves


class _Leg:
    """One phase of the boundary-value problem while it is being stated."""

    def __init__(self, problem: Problem, original: Problem, leg: PhaseSolution, q: Any) -> None:
        self.problem, self.name = problem, leg.name
        own = original.phases[leg.name]
        self._p = model_parameters(original, own, np.zeros(original.parameters.size))
        self._functions = phase_functions(original, leg.name, self._p, np.zeros(0), np.zeros(0)).functions
        self._q, self._n_paths = q, len(leg.path_labels)
        self._controls = leg.controls.size
        model = Model(f"Hamiltonian system of {leg.name}")
        x, lam = model.state("x", leg.states.size), model.state("lam", leg.states.size)
        u = model.control("u", leg.controls.size) if leg.controls.size else ca.SX(0, 1)
        q_in = model.parameter("q", np.zeros(q.shape[0])) if q.shape[0] else q
        n_w = leg.integral_weights.size
        weights = f"w_{leg.name}"
        w_in = model.parameter(weights, np.zeros(n_w)) if n_w else ca.SX(0, 1)

        def along(name: str) -> Any:
            return self._call(name, model.time, x, u, lam, w_in, q_in)

        model.ode({x: along("rates"), lam: -along("state_gradient")})
        stationarity, integrands, slopes = (
            along("switching"),
            along("integrands"),
            along("parameter_gradient"),
        )
        self.w = problem.parameter(weights, n_w, guess=leg.integral_weights) if n_w else ca.SX(0, 1)
        self.leg: Phase = problem.phase(leg.name, model)
        if leg.controls.size:
            self.leg.path("stationarity", stationarity, equals=0.0)
        self.integrals = ca.vertcat(*[self.leg.integral(integrands[i]) for i in range(n_w)])
        self.parameter_integrals = ca.SX(0, 1)
        if q.shape[0]:
            self.parameter_integrals = ca.vertcat(*[self.leg.integral(slopes[i]) for i in range(q.shape[0])])
        self._solution = leg

    def _call(self, name: str, t: Any, x: Any, u: Any, lam: Any, w: Any, q: Any) -> Any:
        return self._functions[name](t, x, u, lam, ca.DM.zeros(self._n_paths), w, self._p, q)

    @property
    def ends(self) -> list[Any]:
        """Arguments of `end_function` that belong to this phase."""
        leg = self.leg
        integrals = self.integrals if self.w.shape[0] else ca.SX(0, 1)
        return [
            leg.initial_state("x"),
            leg.final_state("x"),
            leg.initial_time,
            leg.final_time,
            integrals,
            self._p,
        ]

    def close(self, limits: PhaseLimits, gradients: list[Any]) -> None:
        """State the conditions at the ends; the gradients are those of `EndGradients`, for this phase."""
        leg, problem = self.leg, self.problem
        for end, sign, held, gradient in (
            ("initial", 1.0, limits.initial, gradients[0]),
            ("final", -1.0, limits.final, gradients[1]),
        ):
            x, lam = (leg.initial_state, leg.final_state)[end == "final"]("x"), self._costate(end)
            _constrain(
                problem, f"{end} state of {leg.name}", x, lam + sign * gradient, held, np.isfinite(held)
            )
        if self.w.shape[0]:
            problem.constrain(f"weights of {leg.name}", self.w - gradients[4], equals=0.0)
        free = np.isnan(limits.times)
        leg.time(
            initial=None if free[0] else float(limits.times[0]),
            final=None if free[1] else float(limits.times[1]),
        )
        for k, (end, prefix, sign) in enumerate((("initial", "first", -1.0), ("final", "last", 1.0))):
            if free[k]:
                self._free_time(end, prefix, gradients[2 + k], sign, k)

    def _costate(self, end: str) -> Any:
        return self.leg.initial_state("lam") if end == "initial" else self.leg.final_state("lam")

    def _free_time(self, end: str, prefix: str, gradient: Any, sign: float, k: int) -> None:
        """H = -+dPhi/dt at a free time, with the control there as a parameter of its own."""
        leg, old = self.leg, self._solution
        t, x = (
            (leg.initial_time, leg.initial_state("x"))
            if end == "initial"
            else (leg.final_time, leg.final_state("x"))
        )
        at, side = old.breaks[[0, -1][k]], ("right", "left")[k]
        guess = old.u(at, "right" if side == "right" else "left")
        u = _parameter(self.problem, f"{prefix}_{self.name}", guess)
        here = (t, x, u, self._costate(end), self.w, self._q)
        self.problem.constrain(
            f"{end} time of {self.name}", gradient + sign * self._call("hamiltonian", *here), equals=0.0
        )
        if self._controls:
            self.problem.constrain(
                f"{end} stationarity of {self.name}", self._call("switching", *here), equals=0.0
            )
