r"""Second-order sufficient conditions of a bang-bang solution.

If all controls are at bounds everywhere, the problem has finitely many unknowns :math:`\theta`, one for every switch of
every control (module `switching_time_problem`). A first-order point is a strict local minimum if (Maurer & Osmolovskii,
SIAM J. Control Optim. 42(6), 2004; Osmolovskii & Maurer, Applications to Regular and
Bang-Bang Control, SIAM 2012, ch. 5-7)

* every switching function is zero only at the switches of its control, and crosses zero there with a slope of
  the correct sign (strict bang-bang property),
* the Hessian of the Lagrangian :math:`\Phi + \nu^T\psi` in :math:`\theta` is positive definite on the directions
  tangent to the active conditions with a multiplier. Active conditions without one restrict directions to a half-space.

If several controls switch at the same time, the Hessian has to be positive definite for every order of the switches, on
the directions that preserve it (Poggiolini & Spadini, SIAM J. Control Optim. 49(1), 2011, for two controls). With
several one-sided conditions, positive definiteness on the whole space is only sufficient; otherwise INCONCLUSIVE.

Multipliers are least-squares estimates. Derivatives are extrapolated from two grids, with an error estimate.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy

from gnc_opt.array_types import Array, Indices
from gnc_opt.numerical_tolerances import (
    AT_LIMIT,
    EQUAL,
    JUNCTION_OFFSET_SHARE,
    MINOR,
    NEGLIGIBLE,
    RANK,
    max_norm,
)
from gnc_opt.planning.optimality.bang_bang_sensitivity import RUNGE_KUTTA_ORDER
from gnc_opt.planning.optimality.switching_time_problem import (
    DYNAMICS_TOO_FAST,
    Switches,
    SwitchingTimeProblem,
    SwitchUnknowns,
    find_bound_to_bound_switches,
)
from gnc_opt.planning.problem.hamiltonian_functions import EndGradients
from gnc_opt.planning.solution.optimality_verdict import Condition, ConditionResult
from gnc_opt.planning.solution.phase_trajectory_samples import COSTATE_MIN_SHARE_OF_COST, PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.verification.critical_cone import differentiate_augmented_hamiltonian
from gnc_opt.planning.verification.feasibility import combine_condition_results
from gnc_opt.planning.verification.goh_transformation import mask_zero_hamiltonian_curvature
from gnc_opt.text_html_and_json_formatting import pluralise_noun

MAX_SWITCH_SEQUENCES = 120
"""Largest number of orders of simultaneous switches that are tested."""


def check_strict_bang_bang_property(samples: list[PhaseSamples]) -> Condition:
    """Return the strict bang-bang condition: switching functions cross zero with the correct slope at switches only."""
    meaning = (
        "The switching function must cross zero with a nonzero slope at each switch and must not touch zero between "
        "switches, because an arc could vanish or grow there. The margin is the smallest slope, relative to H per "
        "duration of the phase; a negative slope is a violation. It fails if the switching function next to the "
        f"switch has the wrong sign by more than {NEGLIGIBLE:.0e} of H; smaller values are errors of the costates."
    )
    worst = min(filter(None, map(_find_worst_switching_function_sign, samples)), default=None)
    touching = next(filter(None, map(_find_switching_function_touching_zero, samples)), "")
    name, smallest_slope = "strict switches", np.inf if worst is None else worst.slope
    if touching and (worst is None or not worst.is_sign_violation):
        return Condition(name, ConditionResult.INCONCLUSIVE, 0.0, 0.0, touching, meaning, sufficient=True)
    if worst is None:
        return Condition(
            name, ConditionResult.PASS, 0.0, 0.0, "no switch between control limits", meaning, sufficient=True
        )
    result = combine_condition_results(smallest_slope > NEGLIGIBLE, worst.is_sign_violation)
    return Condition(name, result, -smallest_slope, -NEGLIGIBLE, worst.where, meaning, sufficient=True)


@dataclass(frozen=True, order=True)
class _SwitchingFunctionZero:
    """Worst zero crossing of a switching function at a switch; ``slope`` in shares of H per phase."""

    harmless: bool
    slope: float
    where: str

    @property
    def is_sign_violation(self) -> bool:
        return self.slope < -NEGLIGIBLE and not self.harmless


def _find_worst_switching_function_sign(s: PhaseSamples) -> _SwitchingFunctionZero | None:
    phase = s.phase
    times, channels = find_bound_to_bound_switches(s)
    if not times.size:
        return None
    neighbours = np.searchsorted(phase.breaks, times)
    steps = JUNCTION_OFFSET_SHARE * np.minimum(
        times - phase.breaks[neighbours - 1], phase.breaks[neighbours + 1] - times
    )
    t = np.concatenate([times + k * steps for k in (-2, -1, 1, 2)])
    arguments = t, phase.x(t), phase.applied(t), phase.lam(t), phase.path_multiplier(t)
    values = differentiate_augmented_hamiltonian(s, *arguments)
    values = values.reshape(-1, 4, times.size)[channels, :, np.arange(times.size)]
    slopes = np.stack([values[:, 1] - values[:, 0], values[:, 3] - values[:, 2]]) / steps
    unit = s.control_scale[channels] * phase.duration / s.hamiltonian_scale
    direction = np.sign(phase.applied(times, "left") - phase.applied(times))[channels, np.arange(times.size)]
    signed = np.min(direction * slopes * unit, axis=0)
    zeros = []
    for slope, t, i in zip(signed, times, channels, strict=True):
        location = s.describe_time(t, phase.controls.labels[i])
        violation = _compute_switching_sign_violation(s, int(i), times[channels == i], float(t))
        slope = -np.inf if np.isnan(slope + violation) else slope
        is_harmless = bool(slope >= -NEGLIGIBLE or (-np.inf < slope and violation <= NEGLIGIBLE))
        if is_harmless and slope < -NEGLIGIBLE:
            location += f": the wrong sign, but only by {violation:.1e} of H"
        zeros.append(_SwitchingFunctionZero(is_harmless, float(slope), location))
    return min(zeros)


def _compute_switching_sign_violation(s: PhaseSamples, i: int, times: Array, time: float) -> float:
    """Return the largest wrong-sign value of a switching function between the adjacent switches, relative to H."""
    before, after = np.max(times[times < time], initial=-np.inf), np.min(times[times > time], initial=np.inf)
    inside = (s.times >= before) & (s.times <= after)
    bounds = s.phase.control_bounds
    sign = np.sign(s.u[i, inside] - 0.5 * (bounds.lower[i] + bounds.upper[i]))
    return float(
        np.max(sign * _evaluate_switching_functions(s)[i, inside] * s.control_scale[i] / s.hamiltonian_scale)
    )


def _evaluate_switching_functions(s: PhaseSamples) -> Array:
    return differentiate_augmented_hamiltonian(s, s.times_inside_segments, s.x, s.u, s.lam, s.mu)


def _find_switching_function_touching_zero(s: PhaseSamples) -> str:
    times, channels = find_bound_to_bound_switches(s)
    slopes = np.abs(_evaluate_switching_functions(s)) * s.control_scale[:, None] / s.hamiltonian_scale
    bounds, at_bound = s.phase.control_bounds, np.any(s.is_at_control_bounds, axis=0)
    affine = np.all(mask_zero_hamiltonian_curvature(s), axis=1) | np.all(at_bound, axis=1)
    unique = np.unique(s.times, return_index=True)[1]  # at segment boundaries, rounding would be a minimum
    for i in np.flatnonzero(affine & (bounds.lower < bounds.upper)):
        ends = np.concatenate([s.times[[0, -1]], times[channels == i], s.times[~at_bound[i]]])
        is_distant = np.min(np.abs(s.times[:, None] - ends), axis=1) > MINOR * s.span
        values, inner_samples = slopes[i, unique], unique[1:-1]
        lowest = (values[1:-1] <= values[:-2]) & (values[1:-1] <= values[2:]) & (values[1:-1] < NEGLIGIBLE)
        touching = inner_samples[lowest & is_distant[inner_samples] & at_bound[i, inner_samples]]
        if touching.size:
            return f"{s.describe_sample(int(touching[0]), s.phase.controls.labels[i])}: zero between switches"
    return ""


@dataclass(frozen=True)
class SecondOrderResult:
    """Second-order result of the switching-time problem for one order of its switches; values are dimensionless.

    ``least`` is the smallest eigenvalue of the reduced Hessian, relative to its terms, with its estimated ``error``;
    infinite without degrees of ``freedom``. ``attained``: its direction satisfies all one-sided conditions.
    """

    least: float
    error: float
    freedom: int
    attained: bool

    @property
    def condition_result(self) -> ConditionResult:
        """Result: PASS if the form is positive definite."""
        return combine_condition_results(self.least > self.error, self.least < -self.error and self.attained)


def check_bang_bang_second_order(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients
) -> Condition:
    """Return the condition that the reduced Hessian is positive definite in every order of the switches.

    The theorem must apply (`explain_why_not_bang_bang`).
    """
    meaning = (
        "The Hessian of the Lagrangian with respect to switching times, end times, free end values and parameters "
        "must be positive definite along the directions that preserve the active conditions, in every order of "
        "simultaneous switches. The margin is the smallest eigenvalue, relative to its terms. If it is negative, the "
        "cost decreases along its eigenvector. If it is below its numerical error, the result is inconclusive."
    )
    condition = partial(Condition, "second order", meaning=meaning, sufficient=True)
    switches = {s.phase.name: Switches.from_samples(s) for s in samples}
    if np.prod([float(s.n_switch_sequences) for s in switches.values()]) > MAX_SWITCH_SEQUENCES:
        reason = f"simultaneous switches have more than {MAX_SWITCH_SEQUENCES} possible orders"
        return condition(ConditionResult.INCONCLUSIVE, float("nan"), 0.0, reason)
    unknowns = SwitchUnknowns.from_switches(solution, samples, switches)
    sequences = itertools.product(*(s.list_switch_sequences() for s in switches.values()))
    results = [
        _check_second_order_of_switch_sequence(
            solution, samples, ends, unknowns, dict(zip(switches, orders, strict=True)), switches
        )
        for orders in sequences
    ]
    worst = min(results, key=lambda f: (f.condition_result is not ConditionResult.FAIL, f.least - f.error))
    place = f"{pluralise_noun(worst.freedom, 'degree')} of freedom of the switching times"
    if worst.freedom == 0:
        place = "no degree of freedom: the end conditions determine the switching times"
    elif len(results) > 1:
        place += f", {len(results)} orders of simultaneous switches"
    if worst.condition_result is ConditionResult.INCONCLUSIVE:
        small = abs(worst.least) <= worst.error
        place += ": the curvature is within its error" if small else ": negative, but limits may exclude it"
        place = DYNAMICS_TOO_FAST if np.isnan(worst.least) else place
    phases = ", ".join(s.phase.name for s in samples)
    value = 0.0 if worst.freedom == 0 else -worst.least
    return condition(worst.condition_result, value, -worst.error, f"phase {phases}: {place}")


def _check_second_order_of_switch_sequence(
    solution: Solution,
    samples: list[PhaseSamples],
    ends: EndGradients,
    unknowns: SwitchUnknowns,
    orders: dict[str, tuple[int, ...]],
    switches: dict[str, Switches],
) -> SecondOrderResult:
    """Return the least curvature of the Lagrangian in the critical cone, for one order of simultaneous switches."""
    pieces = {name: switches[name].build_piecewise_control(order) for name, order in orders.items()}
    coarse, fine = (
        SwitchingTimeProblem.from_integrated_controls(solution, samples, ends, unknowns, pieces, n)
        for n in (1, 2)
    )
    if not (coarse.is_finite and fine.is_finite):
        return SecondOrderResult(np.nan, np.nan, unknowns.scale.size, False)
    free, conditions = unknowns.free, fine.conditions
    gradient, jacobian = _extrapolate_richardson(fine.gradient, coarse.gradient), conditions.jacobian
    jacobian = _extrapolate_richardson(jacobian, coarse.conditions.jacobian)
    cost = float(np.max(unknowns.cost_changes[free], initial=0.0)) + max(s.cost_scale for s in samples)
    at_lower, at_upper = conditions.active_limits
    active, rows, norms, multipliers = estimate_nearest_multipliers(gradient, jacobian, fine)
    sides = np.where(at_lower & at_upper, 0, np.where(at_upper, 1, -1))[active]
    precedences = _build_switch_order_constraints(unknowns, orders, switches)[:, free]
    residual, precedence_multipliers = _fit_switch_order_multipliers(
        gradient[free] + rows.T @ multipliers, precedences
    )
    all_multipliers = np.zeros(conditions.values.size)
    all_multipliers[active] = multipliers / norms
    # Conditions and orders without a multiplier only restrict directions to a half-space.
    strong = (sides == 0) | (np.abs(multipliers) > AT_LIMIT * cost)
    fixed = np.vstack([rows[strong], precedences[precedence_multipliers > AT_LIMIT * cost]])
    half_spaces = np.vstack(
        [-sides[~strong, None] * rows[~strong], precedences[precedence_multipliers <= AT_LIMIT * cost]]
    )
    basis = scipy.linalg.null_space(fixed, rcond=RANK) if np.any(fixed) else np.eye(fixed.shape[1])
    if not basis.shape[1]:
        return SecondOrderResult(np.inf, 0.0, 0, True)
    (h_fine, size), (h_coarse, _) = (
        fine.compute_lagrangian_hessian(all_multipliers),
        coarse.compute_lagrangian_hessian(all_multipliers),
    )
    hessian = _extrapolate_richardson(h_fine, h_coarse)[np.ix_(free, free)]
    reduced = basis.T @ hessian @ basis
    eigenvalues, vectors = np.linalg.eigh(0.5 * (reduced + reduced.T))
    error = float(np.linalg.norm(h_fine - h_coarse)) / (2**RUNGE_KUTTA_ORDER - 1) / (size + cost)
    error += EQUAL + float(np.max(np.abs(residual) / unknowns.cost_changes[free]))
    changes = half_spaces @ (basis @ vectors[:, 0])
    attained = bool(np.all(changes >= -AT_LIMIT) or np.all(changes <= AT_LIMIT))
    return SecondOrderResult(float(eigenvalues[0]) / (size + cost), error, basis.shape[1], attained)


def estimate_nearest_multipliers(
    gradient: Array, jacobian: Array, induced: SwitchingTimeProblem
) -> tuple[Indices, Array, Array, Array]:
    """Return the multipliers nearest to those of the solution that minimise the gradient.

    Active conditions that depend on the unknowns (k,), their normalised gradients in the free unknowns (k, n_free), the
    norms of these (k,), and the multipliers of the normalised conditions (k,).
    """
    free, conditions = induced.unknowns.free, induced.conditions
    at_lower, at_upper = conditions.active_limits
    norms = np.linalg.norm(jacobian[:, free], axis=1)
    # Conditions that depend only on fixed unknowns are omitted.
    nonzero = norms > RANK * np.linalg.norm(jacobian, axis=1)
    active = np.flatnonzero((at_lower | at_upper) & nonzero)
    rows = jacobian[np.ix_(active, free)] / norms[active, None]
    guess = conditions.multipliers[active] * norms[active]
    step = np.linalg.lstsq(rows.T, -(gradient[free] + rows.T @ guess), rcond=RANK)[0]
    return active, rows, norms[active], guess + step


def _extrapolate_richardson(fine: Array, coarse: Array) -> Array:
    return np.asarray(fine + (fine - coarse) / (2**RUNGE_KUTTA_ORDER - 1))


def _build_switch_order_constraints(
    unknowns: SwitchUnknowns, orders: dict[str, tuple[int, ...]], switches: dict[str, Switches]
) -> Array:
    """Return the combinations of unknowns that must be >= 0 for the order of the switches to hold (k, n)."""
    rows = [np.zeros((0, unknowns.scale.size))]
    for name, order in orders.items():
        constraints = switches[name].build_switch_sequence_constraints(order)
        block = np.zeros((constraints.shape[0], unknowns.scale.size))
        block[:, unknowns.columns[name][: constraints.shape[1]]] = constraints
        rows.append(block)
    return np.vstack(rows)


def _fit_switch_order_multipliers(residual: Array, precedences: Array) -> tuple[Array, Array]:
    """Return the gradient minus the multipliers of the order of simultaneous switches, and these multipliers."""
    if not precedences.size:  # SciPy may write beyond an empty matrix
        return residual, np.zeros(precedences.shape[0])
    precedence_multipliers = scipy.optimize.nnls(precedences.T, residual)[0]
    return residual - precedences.T @ precedence_multipliers, precedence_multipliers


def is_bang_bang(samples: list[PhaseSamples]) -> bool:
    """Return whether every control is at a bound at all times."""
    return bool(samples) and all(np.all(np.any(s.is_at_control_bounds, axis=0)) for s in samples)


def explain_why_not_bang_bang(samples: list[PhaseSamples]) -> str:
    """Return the reason why the switching-time problem does not apply, or ""."""
    for s in samples:
        if not s.has_duration:
            return f"phase {s.phase.name} has no length"
        at_bound = np.any(s.is_at_control_bounds, axis=0)
        if not np.all(at_bound):
            i, j = np.argwhere(~at_bound)[0]
            return f"{s.describe_sample(j, s.phase.controls.labels[i])}: the control is between its limits"
        if max_norm(s.phase.path_multipliers) > NEGLIGIBLE * s.hamiltonian_scale:
            return f"phase {s.phase.name}: a path constraint is active"
        relative_slopes = np.abs(s.phase.state_multipliers) * s.state_scale[:, None] * s.phase.duration
        if np.max(relative_slopes, initial=0.0) > COSTATE_MIN_SHARE_OF_COST * s.cost_scale:
            return f"phase {s.phase.name}: a state bound is active"
        jumps = np.abs(s.phase.lam_end[:, :-1] - s.phase.lam_start[:, 1:]) * s.state_scale[:, None]
        if np.max(jumps, initial=0.0) > COSTATE_MIN_SHARE_OF_COST * s.cost_scale:
            return f"phase {s.phase.name}: the trajectory touches a state constraint"
    return ""
