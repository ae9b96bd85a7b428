"""Candidates of a search: solutions, estimated errors and the selection of the best one."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from gnc_opt.numerical_tolerances import NEGLIGIBLE, SMALL
from gnc_opt.planning.refinement.collocation_error_estimate import record_iteration
from gnc_opt.planning.solution.optimality_verdict import Verdict
from gnc_opt.planning.solution.refinement_history import Actions, History, RefinementStatus
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.solution_summary import BETTER_COARSE_SOLVE, SUMMARY_MAX_NAMES
from gnc_opt.planning.verification.minimum_principle import integrate_hamiltonian_excess
from gnc_opt.planning.verification.optimality_check import verify

LOCAL_ERROR_RATIO = 1e3
"""Largest local error, relative to the tolerance, with which the estimated error of the objective is used."""

CANDIDATE_ERROR_MARGIN = 3.0
"""Difference of objectives, in estimated errors, above which two solutions belong to different minima."""

_CHATTERING = (
    "A singular arc, {where}, may be of higher order. Such arcs connect to bound arcs only by chattering, that is, by "
    "infinitely many switches that no mesh resolves. The cost is accurate to its change in the last passes; with a "
    "small penalty on the control, the optimum can be resolved."
)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A solution, the history of the solves that led to it, and the stage of the search that found it."""

    solution: Solution
    history: History
    stage: str

    @classmethod
    def from_solve(cls, solution: Solution, tol: float, begin: float, stage: str) -> Candidate:
        """Return the candidate of a single solve that began at ``begin`` (s, `time.perf_counter`)."""
        record = record_iteration(solution, begin, Actions())
        reached = record.solved and record.error <= tol
        status = RefinementStatus.CONVERGED if reached else RefinementStatus.BUDGET_LIMIT
        return cls(solution, History(status, tol, (record,), 0, "", record.seconds), stage)

    @property
    def is_solved(self) -> bool:
        return self.solution.status.solved and self.history.final_iteration.solved

    @property
    def largest_local_error(self) -> float:
        """Largest local error; infinite without a solution."""
        return self.history.final_iteration.error if self.is_solved else math.inf

    @property
    def minimised_cost(self) -> float:
        """Objective, negated if it is maximised."""
        return -self.solution.objective if self.solution.maximised else self.solution.objective

    @property
    def objective_error(self) -> float:
        """Estimated error of the objective, in its unit; infinite without a solution."""
        error = self.solution.objective_error
        return error.absolute_error + self.largest_local_error**2 * error.scale

    @cached_property
    def integrated_hamiltonian_excess(self) -> float:
        """Integral of H minus its minimum; NaN if not finite, or if the costates are too large to resolve it."""
        loss = integrate_hamiltonian_excess(self.solution)
        is_resolved = abs(self.solution.objective) >= self.solution.objective_error.scale
        return loss if math.isfinite(loss) and (is_resolved or loss > 0) else math.nan

    @property
    def is_false_extremal(self) -> bool:
        """Return whether other controls reduce H by more than a negligible share of the objective."""
        return self.integrated_hamiltonian_excess > NEGLIGIBLE * self.solution.objective_error.scale

    @cached_property
    def verdict(self) -> Verdict:
        return verify(self.solution)

    @property
    def verdict_if_checked(self) -> Verdict | None:
        """Verdict if the optimality check has been evaluated, else None."""
        return vars(self).get("verdict", self.solution.verdict)

    @property
    def is_verdict_ok(self) -> bool:
        """Return whether the optimality check has been computed and passed."""
        return self.verdict_if_checked is not None and self.verdict_if_checked.ok

    def is_cost_accurate(self, tol: float) -> bool:
        """Return whether the estimated relative error of the objective is within a tolerance."""
        if not self.largest_local_error <= LOCAL_ERROR_RATIO * tol:
            return False
        error = self.solution.objective_error
        if error.relative_error <= tol:
            return True
        return error.infeasibility + self.integrated_hamiltonian_excess <= tol * error.scale

    def get_errors_for_solution_ranking(self, tol: float) -> tuple[float, float]:
        """Return the relative error of the objective, at least the tolerance, and the local error, for ranking.

        The loss of the minimum principle replaces the estimate if it is smaller.
        """
        if not self.is_solved:
            return math.inf, self.largest_local_error
        error, estimate = self.solution.objective_error, self.objective_error
        if estimate > tol * error.scale and self.integrated_hamiltonian_excess < error.suboptimality:
            by_local_errors = self.largest_local_error**2 * error.scale
            estimate = error.infeasibility + self.integrated_hamiltonian_excess + by_local_errors
        return max(estimate / error.scale, tol), self.largest_local_error

    def has_lower_cost_on_same_mesh(self, other: Candidate) -> bool:
        """Return whether the cost is lower than that of another solution on the same mesh, beyond rounding."""
        margin = SMALL * other.solution.objective_error.scale
        return self.is_solved and self.minimised_cost < other.minimised_cost - margin

    def has_lower_cost(self, other: Candidate, margin: float = CANDIDATE_ERROR_MARGIN) -> bool:
        """Return whether the solution has a lower minimum; use a larger margin if only the other passes the check."""
        if not self.minimised_cost < other.minimised_cost:
            return False
        ours, theirs = (
            max(c.objective_error, c.integrated_hamiltonian_excess) if c.is_solved else math.inf
            for c in (self, other)
        )
        least = SMALL if other.is_verdict_ok and not self.is_verdict_ok else self.largest_local_error
        least *= abs(other.minimised_cost)
        return self.minimised_cost + max(margin * ours, least) < other.minimised_cost - margin * theirs


def select_best_candidate(candidates: Sequence[Candidate], tol: float) -> int:
    """Return the index of the best candidate: passed by the check if any is, with the smallest estimated error.

    Among several within the tolerance, the local error decides. A clearly lower minimum has priority over all others
    unless its local errors are large, since it then may not satisfy the dynamics.
    """
    solved = [k for k, c in enumerate(candidates) if c.is_solved]
    if not solved:
        return len(candidates) - 1
    preferred = [k for k in solved if candidates[k].is_verdict_ok] or solved
    best = min(preferred, key=lambda k: candidates[k].get_errors_for_solution_ranking(tol))
    for k in solved:
        max_error = max(LOCAL_ERROR_RATIO * tol, candidates[best].largest_local_error)
        if candidates[k].largest_local_error <= max_error and candidates[k].has_lower_cost(candidates[best]):
            best = k
    return best


def build_best_solution(
    candidates: Sequence[Candidate],
    stopped_by: RefinementStatus | None,
    tol: float,
    begin: float,
    check: bool,
    first: Candidate | None = None,
) -> Solution:
    """Return the solution of the best candidate with the history of all candidates, its verdict and its status.

    ``stopped_by`` is the status that stopped the search, None if all stages have run. It began at ``begin``, s, of
    `time.perf_counter`. ``first`` is the solve on the first mesh, for the history.
    """
    best_index = select_best_candidate(candidates, tol)
    best = candidates[best_index]
    interrupted = stopped_by is RefinementStatus.INTERRUPTED
    verdict = best.verdict_if_checked if interrupted or not check or not best.is_solved else best.verdict
    status = _choose_refinement_status(best, verdict, stopped_by, {c.history.status for c in candidates}, tol)
    passes = [replace(p, stage=c.stage) for c in candidates for p in c.history.passes]
    history = History(
        status,
        tol,
        tuple(passes),
        sum(len(c.history.passes) for c in candidates[:best_index]) + best.history.chosen,
        _format_status_message(status, best, verdict, tol),
        time.perf_counter() - begin,
        None if first is None or first in candidates else first.history.passes[0],
    )
    solution = best.solution
    provenance = {**solution.provenance, "stage": best.stage}
    provenance |= _describe_lower_cost_on_coarse_mesh(candidates, best)
    return replace(solution, history=history, provenance=provenance).with_verdict(verdict)


def _describe_lower_cost_on_coarse_mesh(candidates: Sequence[Candidate], best: Candidate) -> dict[str, str]:
    """Return a hint at a coarse solve with a lower objective, beyond the estimated errors of both; empty if none."""
    lower = [c for c in candidates if c.is_solved and best.is_solved and c.has_lower_cost(best, margin=1.0)]
    if not lower:
        return {}
    other = min(lower, key=lambda c: c.minimised_cost)
    text = f"objective {other.solution.objective:.6g} on a coarse mesh (stage {other.stage}): try multistart"
    return {BETTER_COARSE_SOLVE: text}


def _choose_refinement_status(
    best: Candidate,
    verdict: Verdict | None,
    stopped_by: RefinementStatus | None,
    candidate_statuses: set[RefinementStatus],
    tol: float,
) -> RefinementStatus:
    if stopped_by is RefinementStatus.INTERRUPTED:
        return stopped_by
    if verdict is None:
        if best.largest_local_error <= tol or best.is_cost_accurate(tol):
            return RefinementStatus.UNCHECKED
        return stopped_by or best.history.status
    if best.largest_local_error <= tol:
        return RefinementStatus.CONVERGED if verdict.ok else RefinementStatus.CONDITIONS_FAIL
    if stopped_by is not None:
        return stopped_by
    if best.history.status is RefinementStatus.BUDGET_LIMIT:  # no mesh improved in the whole sequence
        reasons = (RefinementStatus.POINT_LIMIT, RefinementStatus.FAILED)
        return next((reason for reason in reasons if reason in candidate_statuses), RefinementStatus.STALLED)
    return RefinementStatus.STALLED if best.history.converged else best.history.status


def _format_status_message(
    status: RefinementStatus, best: Candidate, verdict: Verdict | None, tol: float
) -> str:
    """Return the message: local error, estimated error of the objective and failed conditions."""
    error = best.largest_local_error
    text = f"{status.value}: error {error:.1e} (tolerance {tol:.1e})"
    if status is RefinementStatus.CONVERGED:
        return f"{text}, optimality check passed"
    if error > tol:
        text += f" at {best.history.final_iteration.where}"
    if best.is_solved:
        text += f"; estimated error of the objective {best.solution.objective_error.absolute_error:.1e}"
    unmet = () if verdict is None else verdict.open_conditions
    if unmet:
        shown = unmet[:SUMMARY_MAX_NAMES]
        names = "; ".join(f"{c.name} {c.value:.1e} (tolerance {c.tolerance:.0e}) at {c.where}" for c in shown)
        more = f"; and {len(unmet) - SUMMARY_MAX_NAMES} more" if len(unmet) > SUMMARY_MAX_NAMES else ""
        text += f". Not passed: {names}{more}"
    text += f". {status.remedy}"
    where = "" if verdict is None else verdict["second order"].where.partition("singular arcs: ")[2]
    return f"{text} {_CHATTERING.format(where=where.partition(';')[0])}" if where else text
