r"""Accessory problem: neighbouring extremals of a smooth extremal, and the feedback that generates them.

Variations of an extremal whose controls are off their limits and whose H is strictly convex in them satisfy the
accessory equations (`gnc_opt.planning.optimality.accessory`), a linear Hamiltonian system in (X, :math:`\Lambda`).

The end conditions admit a plane of :math:`(\delta x, \delta\lambda, dt_f)` with, for the end cost
:math:`\Phi(x_f, t_f)`,

.. math::
   & \delta x_i + f_i \, dt_f = 0 && \text{of a state that is given there}, \\
   & \delta\lambda_j + \dot\lambda_j \, dt_f = \Phi_{x_j x} (\delta x + f dt_f) + \Phi_{x_j t} \, dt_f &&
     \text{of one that is free}, \\
   & H_x \delta x + f^T \delta\lambda + H_t \, dt_f + \Phi_{tx} (\delta x + f dt_f) + \Phi_{tt} \, dt_f = 0 &&
     \text{where the end is free.}

Propagated backward by the flow, it gives at each time

.. math:: \delta\lambda = S \delta x, \quad dt_f = g \, \delta x, \quad \delta u = -K \delta x, \qquad
   S = \Lambda X^{-1}, \quad g = T X^{-1}, \quad K = H_{uu}^{-1} (H_{ux} + f_u^T S) .

This is the sweep by a Riccati equation (Bryson and Ho, Applied Optimal Control, 1975, sections 6.3 to 6.5) in an
orthonormal frame, which stays finite. X is singular where a time is conjugate to the end: the eigenvalues of
:math:`U U^T`, :math:`U = X + i\Lambda` unitary, pass -1 there in one direction (Arnold, Funct. Anal. Appl. 1(1), 1967).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
import scipy

from gnc_opt.arrays import Array, Mask
from gnc_opt.control.reference import Reference
from gnc_opt.errors import DesignError
from gnc_opt.planning.optimality.accessory import AccessoryEquations, fine_times
from gnc_opt.planning.problem.functions import PhaseFunctions, end_function
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.tolerances import AT_LIMIT, RANK, ROUNDING, magnitude


@dataclass(frozen=True, eq=False)
class SmoothPlan:
    """A flight without active limits: states given at the end (n_states,), and whether its time is free."""

    solution: Solution
    problem: Problem
    leg: PhaseSolution
    functions: PhaseFunctions
    reference: Reference
    given: Mask
    free_end: bool

    @property
    def name(self) -> str:
        """Of the problem."""
        return self.solution.problem_name

    @classmethod
    def of(cls, solution: Solution) -> SmoothPlan:
        """Read a solution of one phase; `DesignError` for active limits or other unsupported conditions."""
        problem, name = solution.need_problem("follow"), solution.problem_name
        if len(solution.phases) != 1:
            raise DesignError(f"the plan '{name}' has {len(solution.phases)} phases: plan in one.")
        (leg,) = solution.phases.values()
        if problem.constraints or solution.parameter_values.size:
            raise DesignError(
                f"the plan '{name}' has boundary constraints or free parameters, which the feedback does not know: "
                "give the end by final(), or follow the plan by design_tvlqr()."
            )
        if problem.phases[leg.name].restatement is not None:
            raise DesignError(
                f"the plan '{name}' was restated with thrust directions and sizes: follow it by design_tvlqr()."
            )
        reference = Reference(solution, tail="hold")
        given = _given(solution, leg)
        free_end = not (leg.final_time_bounds.fixed[0] or leg.duration_bounds.fixed[0])
        plan = cls(solution, problem, leg, solution.functions(leg.name), reference, given, free_end)
        plan._require_no_limit()
        return plan

    def _require_no_limit(self) -> None:
        leg, times = self.leg, self.leg.sample_times()
        inner = times[1:-1]
        paths = self.functions.paths(inner, leg.x(inner), leg.flown(inner))
        for values, box, labels in (
            (leg.flown(times), leg.control_bounds, leg.controls.labels),
            (leg.x(inner), leg.state_bounds, leg.states.labels),
            (paths, leg.path_bounds, leg.path_labels),
        ):
            if not len(labels):
                continue
            scale = magnitude(np.max(np.abs(values), axis=1))
            at = np.any(np.logical_or(*box.near(values, AT_LIMIT * scale)), axis=1)
            if np.any(at):
                raise DesignError(
                    f"'{labels[int(np.flatnonzero(at)[0])]}' of the plan '{self.name}' is on its limit for a while: "
                    "neighbours of smooth plans only are known; plan with a reserve, a bang-bang plan is for "
                    "design_neighbouring_optimal()."
                )


def _given(solution: Solution, leg: PhaseSolution) -> Mask:
    """Return which states are given at the end; the others must be off their limits there."""
    given = np.asarray(leg.final_bounds.fixed, dtype=bool)
    x = leg.x(leg.final_time, "left")
    at = np.logical_or(*leg.final_bounds.near(x, AT_LIMIT * magnitude(np.abs(x)))) & ~given
    if np.any(at):
        label = leg.states.labels[int(np.flatnonzero(at)[0])]
        raise DesignError(
            f"'{label}' ends on a limit in the plan '{solution.problem_name}': give it there by "
            "final(), or leave it free."
        )
    return given


_ACCESSORY_STEPS, _MIN_STEPS_PER_SEGMENT = 400, 4
"""Steps over the plan, and at least so many in every segment of its mesh."""

_CONVEX = 1e-8
"""Least curvature of H in the controls, in shares of the largest: below it H is not strictly convex."""


@dataclass(frozen=True, eq=False)
class Feedback:
    """Feedback at times (k,), s: ``gain`` K, ``end_gain`` g (s per unit), ``cost`` S (of cost to go)."""

    times: Array
    gain: Array
    end_gain: Array
    cost: Array


def feedback(plan: SmoothPlan, last: float) -> Feedback:
    """Return the feedback of a plan up to ``last`` (s) before its end."""
    return _Accessory(plan).feedback(plan.leg.final_time - last)


@dataclass(frozen=True, eq=False)
class _Accessory:
    """The accessory problem of a plan, in states and times in shares of their sizes."""

    plan: SmoothPlan

    @cached_property
    def times(self) -> Array:
        return fine_times(self.plan.leg, _ACCESSORY_STEPS, _MIN_STEPS_PER_SEGMENT)

    @cached_property
    def equations(self) -> AccessoryEquations:
        leg = self.plan.leg
        size = magnitude(np.max(np.abs(leg.flown(self.times)), axis=1))
        return AccessoryEquations(leg, self.plan.functions, size)

    @cached_property
    def worth(self) -> float:
        """Scale of the costates: with H_uu equal to it over the duration, X and Lambda have similar size."""
        curvature = self.equations.slopes(self.times).by_uu
        return float(np.median(np.linalg.norm(curvature, axis=(1, 2)))) * self.plan.leg.duration

    @cached_property
    def flows(self) -> Array:
        """The flow of (X, Lambda) from the end of each step to its beginning, (k, 2n, 2n)."""
        return self.equations.flows(self.times, self.worth, backward=True)

    # --- end ----------------------------------------------------------------------------------------------

    def end_plane(self) -> Array:
        """Return the columns of (X, Lambda, T) at the end, (2n + 1, n), the last row zero where it is given."""
        plan, leg = self.plan, self.plan.leg
        n, duration, states = leg.states.size, leg.duration, self.equations.state_size
        t, x, lam = leg.final_time, leg.x(leg.final_time, "left"), leg.lam(leg.final_time, "left")
        u = leg.flown(leg.final_time, "left")
        f, none = plan.functions.rates(t, x, u), np.zeros(len(leg.path_labels))
        H_x = plan.functions.state_gradient(t, x, u, lam, none)
        H_t = float(plan.functions.time_gradient(t, x, u, lam, none))
        by_xx, by_xt, by_tt = self._end_curvature()
        rows = np.zeros((n + 1, 2 * n + 1))
        for i in range(n):
            if plan.given[i]:
                rows[i, i], rows[i, -1] = 1.0, f[i]
            else:
                rows[i, :n], rows[i, n + i] = -by_xx[i], 1.0
                rows[i, -1] = -H_x[i] - by_xx[i] @ f - by_xt[i]
        rows[n, :n], rows[n, n : 2 * n] = H_x + by_xt, f
        rows[n, -1] = H_t + by_xt @ f + by_tt
        if not plan.free_end:
            rows[n] = np.eye(2 * n + 1)[-1]
        rows *= np.concatenate([states, self.worth / states, [duration]])
        rows /= np.linalg.norm(rows, axis=1, keepdims=True)
        plane = scipy.linalg.null_space(rows, rcond=RANK)
        if plane.shape[1] != n:
            raise DesignError(
                f"the conditions at the end of the plan '{plan.name}' depend on each other to first order: no "
                "neighbour is determined by them."
            )
        if not plan.free_end:
            plane[-1] = 0.0  # it is but for rounding
        return np.asarray(plane)

    def _end_curvature(self) -> tuple[Array, Array, float]:
        """Return the second derivatives of the cost at the end by final states and time."""
        plan, leg = self.plan, self.plan.leg
        function = end_function(plan.problem)
        inputs = [ca.SX.sym("v", function.size1_in(i)) for i in range(function.n_in())]
        gradients = function(*inputs)[2:]
        second = [
            ca.jacobian(gradients[1], inputs[1]),
            ca.jacobian(gradients[1], inputs[3]),
            ca.jacobian(gradients[3], inputs[3]),
        ]
        ends = [
            leg.x(leg.initial_time),
            leg.x(leg.final_time, "left"),
            leg.initial_time,
            leg.final_time,
            leg.integrals,
            leg.parameters,
        ]
        values = ca.Function("end", inputs, [ca.densify(e) for e in second])(
            *ends, plan.solution.parameter_values, plan.solution.constraint_multipliers
        )
        by_xx, by_xt, by_tt = (np.asarray(v.full()) for v in values)
        return by_xx, by_xt[:, 0], float(by_tt[0, 0])

    # --- feedback -----------------------------------------------------------------------------------------

    def feedback(self, until: float) -> Feedback:
        """Return the feedback up to a time (s)."""
        self._require_convex()
        n = self.plan.leg.states.size
        states, controls = self.equations.state_size, self.equations.control_size
        plane = self.end_plane()
        frames = np.empty((self.times.size, 2 * n + 1, n))
        frames[-1] = plane
        for k in range(self.times.size - 2, -1, -1):
            frame, growth = np.linalg.qr(self.flows[k] @ frames[k + 1, : 2 * n])
            end = scipy.linalg.solve_triangular(growth, frames[k + 1, 2 * n], trans="T")
            frames[k] = np.vstack([frame, end])
        early = self.times <= until
        self._require_no_conjugate(frames[:, :n], frames[:, n : 2 * n], early)
        X, Lam, T = frames[early, :n], frames[early, n : 2 * n], frames[early, 2 * n :]
        told = np.linalg.solve(X.transpose(0, 2, 1), np.concatenate([Lam, T], axis=1).transpose(0, 2, 1))
        told = told.transpose(0, 2, 1)
        S = 0.5 * (told[:, :n] + told[:, :n].transpose(0, 2, 1)) * self.worth
        by_uu, by_ux, _, _, f_u = self.equations.slopes(self.times[early])
        K = np.linalg.solve(by_uu, by_ux + f_u.transpose(0, 2, 1) @ S)
        return Feedback(
            self.times[early],
            K * controls[:, None] / states,
            told[:, n] * self.plan.leg.duration / states,
            S / states[:, None] / states,
        )

    def _require_convex(self) -> None:
        curvature = np.linalg.eigvalsh(self.equations.slopes(self.times).by_uu)
        k = int(np.argmin(curvature[:, 0]))
        if not curvature[k, 0] > _CONVEX * np.max(np.abs(curvature)):
            raise DesignError(
                f"the Hamiltonian of the plan '{self.plan.name}' is not strictly convex in its controls at "
                f"{self.times[k]:.6g} s (curvature {curvature[k, 0] / np.max(np.abs(curvature)):.2g} of the largest): "
                "its controls do not follow the state uniquely; a bang-bang plan is for "
                "design_neighbouring_optimal(), others follow by design_tvlqr()."
            )

    def _require_no_conjugate(self, X: Array, Lam: Array, early: Mask) -> None:
        sizes = np.linalg.svd(X[early], compute_uv=False)
        if not np.min(sizes[0]) > ROUNDING:
            raise DesignError(
                f"the controls of the plan '{self.plan.name}' do not move all of its states "
                f"({', '.join(self.plan.leg.states.labels)}): state the problem without what is conserved, or follow "
                "the plan by design_tvlqr()."
            )
        time = conjugate_time(self.times, X, Lam)
        if time is not None:
            raise DesignError(
                f"the plan '{self.plan.name}' fails the second-order condition: {time:.6g} s is conjugate to its end, "
                "so that it is no minimum; solve from another guess."
            )


def conjugate_time(times: Array, X: Array, Lam: Array) -> float | None:
    """Return the last time (s) before the end at which X (k, n, n) is singular; ``None`` if there is none."""
    unitary = X + 1j * Lam
    product = unitary @ unitary.transpose(0, 2, 1)
    angles = np.angle(-np.linalg.eigvals(product)) % (2 * np.pi)
    apart = np.min(np.minimum(angles, 2 * np.pi - angles), axis=1)
    left = np.flatnonzero(apart > ROUNDING)
    if not left.size:
        return None
    total = np.sum(angles[: left[-1] + 1], axis=1)
    jumps = np.flatnonzero(np.abs(np.diff(total)) > np.pi)
    return float(times[jumps[-1]]) if jumps.size else None
