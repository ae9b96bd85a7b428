"""What one way of refining led to, and which of several is kept."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gnc_opt.planning.refinement.arcs.curvature import regular_channels
from gnc_opt.planning.refinement.arcs.structure import PhaseStructure
from gnc_opt.planning.refinement.error import estimate_errors
from gnc_opt.planning.refinement.iterations import PROMISING, pass_record
from gnc_opt.planning.solution.history import History, RefinementStatus
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.verdict import Result, Verdict
from gnc_opt.planning.verification.engine import verify

CLOSE, NEARLY = 1e2, 1e-2
"""A structure is nearly right with an error of so many tolerances, and offences of the verdict below this. No finer
mesh mends an offence of more than so many tolerances: with the tolerance of a pass errors fall by its square, costates
by its first power."""

NAMED = 3
"""So many open conditions are named."""

_CHATTERING = (
    "A singular arc, {where}, may be of higher order: such arcs meet arcs on bounds by chattering only, ever faster "
    "switches that no mesh resolves. The cost is then right to what it moved by in the last passes; with a small "
    "penalty on the control there is an optimum that can be resolved."
)


@dataclass(frozen=True, eq=False)
class RefinementAttempt:
    """What one way of refining led to, the structure that it began with, if any, and whether on the mesh as it was."""

    solution: Solution
    history: History
    begun: Mapping[str, PhaseStructure] | None = None
    on_mesh: bool = False

    @property
    def error(self) -> float:
        """Of its solution; infinite if no pass had one."""
        final = self.history.final
        return final.error if final.solved else math.inf

    @property
    def work(self) -> float:
        """Of all its passes but, on meshes, the first one, which was given."""
        return sum(p.work for p in self.history.passes[self.begun is None :])

    @property
    def leads_on(self) -> bool:
        """Whether errors fell fast enough, from pass to pass on average, for others to follow; see `PROMISING`."""
        first, *others = self.history.passes
        return bool(others) and self.error <= PROMISING ** len(others) * first.error

    @property
    def stopped(self) -> bool:
        """Whether Ctrl-C or the limit on time ended it."""
        return self.history.status is RefinementStatus.INTERRUPTED

    @cached_property
    def verdict(self) -> Verdict:
        """On its solution."""
        return verify(self.solution)

    @property
    def final(self) -> bool:
        """Whether nothing else is worth trying: it has been stopped, or it came to rest and passes the verdict."""
        if self.stopped or not self.history.final.solved:  # whose solution is the one that it began with
            return self.stopped
        if self.history.status is RefinementStatus.PASS_LIMIT:  # on its way still
            return False
        rests = self.history.converged or not self.solution.structure or self.error <= self.history.tolerance
        return rests and self.verdict.ok

    @property
    def offence(self) -> float:
        """By how many tolerances the worst necessary condition of the verdict is missed; 0 if none is."""
        missed = [c.value / abs(c.tolerance) for c in self.verdict.open if not c.sufficient]
        return max((math.inf if math.isnan(value) else value for value in missed), default=0.0)

    @property
    def resolvable(self) -> bool:
        """Whether conditions of the verdict are open that a finer mesh can meet: none of them by far.

        Or by far, where a control that H determines is flown in steps because its polynomial leaves the bounds: narrow
        as that may be, it is as far off as the control moves in a step.
        """
        necessary = [c for c in self.verdict.open if not c.sufficient]
        near = all(c.value <= CLOSE * c.tolerance for c in necessary)
        return bool(necessary) and (near or self.in_steps)

    @property
    def in_steps(self) -> bool:
        """Whether a control in which H is strictly convex is flown in steps somewhere; see `FlownControl`."""
        samples = self.solution.samples().values()
        return any(bool(np.any(s.leg.flown.held[regular_channels(s)])) for s in samples)

    @property
    def nearly_ok(self) -> bool:
        """Whether every necessary condition of the verdict holds but for what a finer mesh may take away."""
        return all(c.sufficient or c.value < NEARLY for c in self.verdict.open)


def interrupted(solution: Solution, tol: float, begin: float) -> RefinementAttempt:
    """Return the given solution as what is left when Ctrl-C came between two attempts."""
    record = pass_record(solution, estimate_errors(solution), begin, "interrupted")
    return RefinementAttempt(solution, History(RefinementStatus.INTERRUPTED, tol, (record,), 0, ""))


def result_of(given: Solution, attempts: Sequence[RefinementAttempt], tol: float, begin: float) -> Solution:
    """Return the solution to keep, its history with the passes of all attempts, and its verdict."""
    if attempts[-1].stopped:
        attempts = [*attempts, interrupted(given, tol, begin)]
        chosen = min(range(len(attempts)), key=lambda k: attempts[k].error)
    elif attempts[-1].final:
        chosen = len(attempts) - 1
    else:
        chosen = _least_wrong(attempts, tol)
    solution, history = attempts[chosen].solution, attempts[chosen].history
    verdict = None if attempts[-1].stopped else attempts[chosen].verdict
    status = RefinementStatus.INTERRUPTED if verdict is None else history.status
    within = history.final.solved and history.final.error <= tol
    if (history.converged or within) and verdict is not None:
        status = RefinementStatus.CONVERGED
        if not verdict.ok:
            status = RefinementStatus.VERDICT_FAILS
        elif history.final.error > tol:  # a structure that stands, and cannot be resolved any better
            status = RefinementStatus.STALLED
    told = replace(
        history,
        status=status,
        tolerance=tol,
        passes=tuple(p for a in attempts for p in a.history.passes),
        chosen=sum(len(a.history.passes) for a in attempts[:chosen]) + history.chosen,
        message=_message(status, history, verdict, tol),
        seconds=time.perf_counter() - begin,
    )
    return replace(solution, history=told).with_verdict(verdict)


def _least_wrong(attempts: Sequence[RefinementAttempt], tol: float) -> int:
    """Return which attempt to keep if none convinces: the last mesh, or a structure that is more right.

    A structure that nobody asked for is not worth more than a mesh within the tolerance. Where that is not reached, one
    within it is, which offends less against the verdict.
    """
    meshes = [k for k, a in enumerate(attempts) if not a.solution.structure and a.history.final.solved]
    if not meshes:
        return len(attempts) - 1
    mesh = attempts[meshes[-1]]
    if mesh.error <= tol:
        return meshes[-1]
    accurate = [k for k, a in enumerate(attempts) if a.error <= tol and a.offence < mesh.offence]
    return min(accurate, key=lambda k: attempts[k].offence, default=meshes[-1])


def _message(status: RefinementStatus, history: History, verdict: Verdict | None, tol: float) -> str:
    """Say how it ended: the error asked for and reached, and what is open."""
    text = f"{status.value}: error {history.final.error:.1e} (wanted {tol:.1e})"
    if status is RefinementStatus.CONVERGED:
        return f"{text}, verdict ok"
    if history.final.error > tol:
        text += f" at {history.final.where}"
    left = () if verdict is None else verdict.open
    if left:
        named = "; ".join(
            f"{c.name} {c.value:.1e} (tolerance {c.tolerance:.0e}) at {c.where}" for c in left[:NAMED]
        )
        more = f"; and {len(left) - NAMED} more" if len(left) > NAMED else ""
        text += f". Open: {named}{more}"
    return f"{text}. {status.remedy}{'' if verdict is None else _on_singular_arcs(verdict)}"


def _on_singular_arcs(verdict: Verdict) -> str:
    """Say what may keep a refinement with singular arcs from its end, and where they are."""
    told = [c for c in verdict.conditions if c.name == "singular arcs" and c.result is not Result.PASS]
    return "".join(f" {_CHATTERING.format(where=c.where)}" for c in told)
