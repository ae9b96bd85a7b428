r"""Singular arcs: Goh's condition and the generalised Legendre-Clebsch condition.

If controls :math:`u_S` are interior and H is affine in them, their switching functions
:math:`\phi = \partial H/\partial u_S` vanish along the whole arc with all their time derivatives. The first derivative
that contains :math:`u_S`, the 2k-th for jointly appearing controls, defines the order k of the arc. A minimum requires
(Kelley, Kopp & Moyer, in Leitmann, Topics in Optimization, 1967; Krener, SIAM J. Control Optim. 15(2), 1977)

.. math:: \frac{\partial}{\partial u_S}\frac{d^j\phi}{dt^j} = 0 \text{ for } j < 2k, \qquad
          K = (-1)^k \frac{\partial}{\partial u_S}\frac{d^{2k}\phi}{dt^{2k}} \ge 0;

for j = 1 this is Goh's condition. K > 0 is the strengthened form. The time derivatives are symbolic, along
:math:`\dot x = f,\ \dot\lambda = -\partial H/\partial x`; other controls are constant at their bounds, or vary so
that their :math:`\partial H/\partial u` stays zero. They are scaled by H, control ranges and powers of the arc length.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.array_types import Array, Indices, Mask, find_equal_value_intervals
from gnc_opt.model.casadi_function_evaluation import evaluate_casadi_batch
from gnc_opt.numerical_tolerances import EQUAL, MINOR, SMALL
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.optimality_verdict import Condition, ConditionResult
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.verification.feasibility import combine_condition_results

SINGULAR_ARC_MAX_ORDER = 3
"""Largest order of singular arcs that is tested."""

MAX_INSTRUCTIONS = 200_000
"""Size of the derivatives of a switching function above which no further derivative is computed."""

TOO_LARGE = "the switching function has too large a derivative of order"

COUPLED = "H couples the control with another one that H determines"

NOT_AFFINE = "H is not affine in the controls between their bounds; its curvature vanishes at this place only"


@dataclass(frozen=True)
class SingularArc:
    """Result of the generalised Legendre-Clebsch condition for one arc of ``channels`` (controls).

    ``order`` is k, 0 if it was not found. ``least`` is the smallest eigenvalue of K along the arc, or minus the largest
    derivative that should vanish; ``why`` the reason of an inconclusive result (or of a failure by coupling). The first
    of the ``samples``, and one after the last, delimit the arc.
    """

    place: str
    order: int = 0
    least: float = 0.0
    why: str = ""
    channels: tuple[int, ...] = field(default=(), compare=False)
    samples: tuple[int, ...] = field(default=(), compare=False)


def check_generalised_legendre_clebsch(arcs: Sequence[SingularArc], tolerance: float) -> Condition:
    """Return Goh's and the strengthened generalised Legendre-Clebsch condition for all singular arcs."""
    name = "generalised Legendre-Clebsch"
    meaning = (
        "Along a singular arc, the first time derivative of the switching functions that contains the controls must "
        "have an even order 2k, and (-1)^k times its derivative with respect to the controls must be positive "
        "definite. The margin is the smallest eigenvalue, relative to H over the length of the arc. If it is negative, "
        "fast control pulses of alternating sign lower the cost."
    )
    if not arcs:
        return Condition(name, ConditionResult.PASS, 0.0, 0.0, "no singular arc", meaning, sufficient=True)
    worst = min(arcs, key=lambda arc: (not arc.least < -tolerance, not arc.why, arc.least))
    result = combine_condition_results(not worst.why and worst.least > tolerance, worst.least < -tolerance)
    reason = worst.why or (f"order {worst.order}" if worst.order else "Goh's condition")
    location = f"{worst.place}: {reason}"
    return Condition(name, result, -worst.least, -tolerance, location, meaning, sufficient=True)


def mask_first_order_singular_arcs(s: PhaseSamples, arcs: Sequence[SingularArc], tolerance: float) -> Mask:
    """Return where second derivatives of switching functions determine controls (m, n_samples), on arcs of a phase."""
    mask = np.zeros((s.phase.controls.size, s.times.size), dtype=bool)
    for arc in arcs:
        determined = arc.order == 1 and not arc.why and arc.least > tolerance
        mask[list(arc.channels), slice(*arc.samples)] = determined
    return mask


def analyse_singular_arcs(
    problem: Problem, s: PhaseSamples, singular: Mask, inside: Mask, tolerance: float
) -> list[SingularArc]:
    """Return the results of arcs with interior controls without curvature of H; bool arrays (m, n_samples)."""
    singular = singular & inside
    arcs = []
    for first, last in find_equal_value_intervals(np.vstack([singular, inside])):
        channels = np.flatnonzero(singular[:, first])
        if channels.size and s.times[last - 1] - s.times[first] > MINOR * s.span:
            regular = np.flatnonzero(inside[:, first] & ~singular[:, first])
            span = np.arange(first, last)
            arcs.append(_analyse_singular_arc(problem, s, channels, regular, span, tolerance))
    return arcs


def _analyse_singular_arc(
    problem: Problem, s: PhaseSamples, channels: Indices, regular: Indices, span: Indices, tolerance: float
) -> SingularArc:
    labels = ", ".join(s.phase.controls.labels[i] for i in channels)
    location = f"phase {s.phase.name}, {labels} from {s.describe_times(*s.times[span[[0, -1]]])}"
    indices, regular_controls = tuple(channels.tolist()), tuple(regular.tolist())
    arc = partial(SingularArc, location, channels=indices, samples=(int(span[0]), int(span[-1]) + 1))
    key = "derivatives of switching functions", s.phase.name, indices, regular_controls
    derivatives = problem.memoize(key, lambda: SwitchingFunctionDerivatives(s, channels, regular))
    if derivatives.coupled:
        smallest = _compute_singular_curvature(s, channels, regular, span)
        note = f"; H has negative curvature along both, {-smallest:.1e} of H: fast pulses gain at most an eighth of it"
        return arc(least=smallest, why=COUPLED + (note if smallest < -EQUAL else ""))
    first_size = 0.0
    for j in range(2 * SINGULAR_ARC_MAX_ORDER + 1):
        function = derivatives.differentiate_switching_function_by_controls(j)
        if function is None:
            return arc(why=f"{TOO_LARGE} {j}")
        matrices = _evaluate_scaled_matrices(s, channels, span, function) * np.ptp(s.times[span]) ** j
        size = float(np.max(np.abs(matrices)))
        first_size = size if j == 0 else first_size
        if size <= tolerance:
            continue
        if SMALL * size <= first_size:  # time derivatives of a curvature that only becomes small
            return arc(why=NOT_AFFINE)
        if j % 2:
            return arc(least=-size)
        matrix = (-1) ** (j // 2) * 0.5 * (matrices + matrices.transpose(0, 2, 1))
        smallest = float(np.min(np.linalg.eigvalsh(matrix)))
        why = "" if abs(smallest) > tolerance else f"the matrix of order k = {j // 2} is singular"
        return arc(j // 2, smallest, why)
    return arc(why=f"no derivative up to order {2 * SINGULAR_ARC_MAX_ORDER} determines the control")


def _compute_singular_curvature(s: PhaseSamples, channels: Indices, regular: Indices, span: Indices) -> float:
    """Return the smallest curvature of H along singular controls with optimal regular ones, relative to H."""
    scale, hessian = s.control_scale, np.moveaxis(s.control_hessian[:, :, span], -1, 0)
    hessian = hessian * np.outer(scale, scale) / s.hamiltonian_scale
    cross = hessian[:, regular[:, None], channels]
    among_regular = hessian[:, regular[:, None], regular]
    schur = -cross.transpose(0, 2, 1) @ np.linalg.pinv(among_regular, hermitian=True) @ cross
    return float(np.min(np.linalg.eigvalsh(schur)))


def _evaluate_scaled_matrices(s: PhaseSamples, channels: Indices, span: Indices, function: Any) -> Array:
    """Return matrices (n_samples, m, m) at samples of an arc, over control ranges and relative to H."""
    numbers = np.concatenate([s.functions.weights, s.functions.p, s.functions.q])
    trajectory = s.times[None, span], s.x[:, span], s.u[:, span], s.lam[:, span]
    values = evaluate_casadi_batch(function, span.size, *trajectory, numbers)
    scale = s.control_scale[channels]
    matrices = values.T.reshape(span.size, channels.size, channels.size)
    return np.asarray(matrices * np.outer(scale, scale) / s.hamiltonian_scale)


class SwitchingFunctionDerivatives:
    """Time derivatives of switching functions; ``coupled``: controls determined by H depend on singular ones."""

    def __init__(self, s: PhaseSamples, channels: Indices, regular: Indices) -> None:
        functions = s.functions.functions
        sizes = [functions["hamiltonian"].size1_in(i) for i in range(8)]
        t, x, u, lam = (ca.SX.sym("v", n) for n in sizes[:4])
        weights, p, q = (ca.SX.sym("v", n) for n in sizes[5:])
        arguments = (t, x, u, lam, np.zeros(sizes[4]), weights, p, q)
        hamiltonian = functions["hamiltonian"](*arguments)
        self._inputs = [t, x, u, lam, ca.vertcat(weights, p, q)]
        self._own = u[channels.tolist()]
        self._along = ca.vertcat(t, x, lam)
        self._rates = ca.vertcat(1, functions["rates"](*arguments), -ca.gradient(hamiltonian, x))
        slopes = ca.gradient(hamiltonian, u)
        self._values = [slopes[channels.tolist()]]
        self._functions: dict[int, Any] = {}
        determined, slope = u[regular.tolist()], slopes[regular.tolist()]
        self.coupled = ca.jacobian(slope, self._own).nnz() > 0
        if regular.size:  # dH/du = 0 determines their motion
            drift = ca.jtimes(slope, self._along, self._rates)
            self._rates = ca.vertcat(self._rates, -ca.solve(ca.jacobian(slope, determined), drift))
            self._along = ca.vertcat(self._along, determined)

    def differentiate_switching_function_by_controls(self, j: int) -> Callable[..., Any] | None:
        """Return the derivative of the j-th time derivative in the controls, by rows; None if it is too large."""
        if j not in self._functions:
            matrix = ca.vec(ca.densify(ca.jacobian(self._differentiate_switching_functions(j), self._own)).T)
            function = ca.Function("by_controls", self._inputs, [matrix])
            self._functions[j] = function if function.n_instructions() <= MAX_INSTRUCTIONS else None
        derivative: Callable[..., Any] | None = self._functions[j]
        return derivative

    def _differentiate_switching_functions(self, j: int) -> Any:
        while len(self._values) <= j:
            self._values.append(ca.jtimes(self._values[-1], self._along, self._rates))
        return self._values[j]
