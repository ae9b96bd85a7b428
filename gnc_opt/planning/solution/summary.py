"""The summary of a solution that a person reads: what `print(solution)` shows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Protocol

import numpy as np

from gnc_opt.planning.nlp.status import Status
from gnc_opt.planning.problem.check import bounds_to_give
from gnc_opt.planning.problem.expressions import OutsideTable
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.accuracy import Accuracy
from gnc_opt.planning.solution.diagnosis import Violation
from gnc_opt.planning.solution.history import History, RefinementStatus, Statistics
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.quality import Quality
from gnc_opt.planning.solution.verdict import LowerBound, Verdict

LABEL_WIDTH = 13
WORST = 3
"""How many broken constraints, or overshooting controls, are named."""

ROUNDING_VIOLATION = 1e-9
"""Relative bound violations below this are rounding."""

_UNKEPT = {
    RefinementStatus.CONVERGED: "ok when it was refined",
    RefinementStatus.CONDITIONS_FAIL: "NOT ok when it was refined",
}
"""What is known of the verdict of a refinement without the verdict itself, after loading."""


class SummarisedSolution(Protocol):
    """What is printed of a solution, see `gnc_opt.Solution`."""

    @property
    def problem_name(self) -> str: ...
    @property
    def status(self) -> Status: ...
    @property
    def objective(self) -> float: ...
    @property
    def maximised(self) -> bool: ...
    @property
    def phases(self) -> Mapping[str, PhaseSolution]: ...
    @property
    def violations(self) -> tuple[Violation, ...]: ...
    @property
    def statistics(self) -> Statistics: ...
    @property
    def history(self) -> History | None: ...
    @property
    def problem(self) -> Problem | None: ...
    @property
    def bound(self) -> LowerBound | None: ...
    @property
    def gap(self) -> float | None: ...
    @property
    def verdict(self) -> Verdict | None: ...
    @property
    def converged(self) -> bool: ...
    @property
    def quality(self) -> Quality: ...
    @property
    def accuracy(self) -> Accuracy: ...
    def phase(self, name: str | None = None) -> PhaseSolution: ...
    def outside_tables(self) -> list[OutsideTable]: ...


def summary(solution: SummarisedSolution) -> str:
    """Return at most seven lines on a solution that is ok, more on others.

    Status and objective; accuracy in the units of the problem; times; mesh and cost of the solve; worst
    defect between nodes; worst bound violation between nodes; propagation error of the applied control,
    each with its place. A refined solution shows its verdict and the requested and reached error; a verdict
    that is ok replaces defect and bounds. Further lines give a known lower bound of the cost, the
    reformulated norms, controls whose polynomial overshoots, tables whose range is left, the remedy after a
    failed solve, and a warning if the figures date from when the solution was saved.

    Parameters
    ----------
    solution : Solution

    Returns
    -------
    str
        Lines without a trailing newline.

    Examples
    --------
    >>> from gnc_opt.report import summary
    >>> print(summary(solution).splitlines()[0].partition(",")[0])
    rest to rest in minimum time: refined (converged)
    """
    quality = known_quality(solution)
    lines = [
        _headline(solution),
        *_accuracy(solution),
        *_failure(solution),
        *_refinement(solution),
        *_bound(solution),
        *_restated(solution),
        _times(solution),
        _cost(solution),
    ]
    lines += list(_quality_lines(quality, brief=solution.converged))
    lines += list(_overshoot(solution))
    lines += [_line("table", str(found)) for found in left_tables(solution)]
    if quality is not None and solution.problem is None:
        lines.append(
            _line("note", "defect, bounds and propagation were measured when the solution was saved")
        )
    return "\n".join(lines)


def known_quality(solution: SummarisedSolution) -> Quality | None:
    """Return the quality figures, measured now or stored in the file; None if neither is possible."""
    if solution.problem is None and "quality" not in vars(solution):
        return None
    return solution.quality


def overshooting_controls(leg: PhaseSolution) -> dict[str, float]:
    """Return the controls whose polynomial leaves its bounds between nodes.

    Returns
    -------
    dict
        From component label to the largest overshoot in the control's unit, the worst relative one first.
    """
    lower, upper = leg.control_bounds.lower[:, None], leg.control_bounds.upper[:, None]
    times = leg.sample_times(32)
    values = np.hstack([leg.u(times, "right"), leg.u(times, "left")])
    worst = np.max(np.maximum(lower - values, values - upper), axis=1, initial=0.0)
    span = (upper - lower)[:, 0]
    relative = worst / np.where(np.isfinite(span) & (span > 0), span, 1.0)
    held = np.any(leg.flown.held, axis=1).tolist()
    return {leg.controls.labels[i]: float(worst[i]) for i in np.argsort(-relative, kind="stable") if held[i]}


def mesh_text(solution: SummarisedSolution) -> str:
    """Return ``"20x3"``, or ``"ascent 20x3, coast 5x2"`` for several phases."""
    if len(solution.phases) == 1:
        return str(solution.phase().mesh)
    return ", ".join(f"{name} {leg.mesh}" for name, leg in solution.phases.items())


def _headline(solution: SummarisedSolution) -> str:
    sense = "maximised" if solution.maximised else "minimised"
    history = solution.history
    if not solution.status.solved:
        status = f"NOT SOLVED ({_words(solution.status.value)})"
    elif history is None:
        status = f"solved ({_words(solution.status.value)})"
    else:
        reached = history.converged or history.status is RefinementStatus.UNCHECKED
        status = f"{'refined' if reached else 'NOT CONVERGED'} ({_words(history.status.value)})"
    return f"{solution.problem_name}: {status}, objective {solution.objective:.10g} ({sense})"


def _accuracy(solution: SummarisedSolution) -> Iterator[str]:
    """Return the accuracy of a solved problem; nothing without the problem, from which it is computed."""
    if solution.status.solved and solution.problem is not None:
        yield _line("accuracy", str(solution.accuracy))


def _failure(solution: SummarisedSolution) -> Iterator[str]:
    if solution.status.solved:
        return
    yield _line("what to do", solution.status.remedy)
    for violation in solution.violations[:WORST]:
        yield _line("broken", f"{violation.name}, off by {violation.amount:.2g} of its scale")


def _refinement(solution: SummarisedSolution) -> Iterator[str]:
    """Return the requested and reached error of a refinement and the open conditions of its verdict."""
    history = solution.history
    if history is None:
        return
    verdict = solution.verdict
    if verdict is None:
        yield _line("verdict", _UNKEPT.get(history.status, "not judged: verify() does"))
    else:
        yield _line("verdict", verdict.headline)
        for c in verdict.open[:WORST]:
            yield _line("open", f"{c.name} {c.value:.1e} (tolerance {c.tolerance:.0e}) at {c.location_text}")
        if solution.problem is not None and (missing := bounds_to_give(solution.problem)):
            yield _line("what to do", missing)
    final = history.final
    yield _line(
        "refinement",
        f"error {final.error:.1e} between the nodes (wanted {history.tolerance:.1e}), "
        f"{len(history.passes)} pass{'es' * (len(history.passes) != 1)}, {history.seconds:.2f} s"
        + ("" if history.converged else f": {final.where}"),
    )


def _bound(solution: SummarisedSolution) -> Iterator[str]:
    if solution.bound is not None:
        side = "at most" if solution.maximised else "at least"
        yield _line("bound", f"{side} {solution.bound}; gap {solution.gap:.1e}")


def _restated(solution: SummarisedSolution) -> Iterator[str]:
    for leg in solution.problem.phases.values() if solution.problem is not None else ():
        for text in leg.restatement.texts if leg.restatement is not None else ():
            yield _line("norm", f"{text}{f', phase {leg.name}' * (len(solution.phases) > 1)}")


def _times(solution: SummarisedSolution) -> str:
    return _line(
        "time",
        "; ".join(
            f"{leg.name} {leg.initial_time:.10g} to {leg.final_time:.10g} s"
            for leg in solution.phases.values()
        ),
    )


def _cost(solution: SummarisedSolution) -> str:
    scheme = next(iter(solution.phases.values())).scheme
    return _line("mesh", f"{mesh_text(solution)} {scheme}, {solution.statistics.text}")


def _quality_lines(quality: Quality | None, brief: bool) -> Iterator[str]:
    if quality is None:
        yield _line("quality", "unknown: load the solution with its problem to measure it")
        return
    if not brief:
        yield _line(
            "defect", f"{quality.max_defect:.2g} relative, worst between nodes: {quality.defect_location}"
        )
    if quality.max_bound_violation <= ROUNDING_VIOLATION:
        if not brief:
            yield _line("bounds", "kept at and between nodes")
    else:
        yield _line(
            "bounds", f"broken by {quality.max_bound_violation:.2g} of their range: {quality.bound_location}"
        )
    if np.isfinite(quality.propagation_error):
        miss = f"{quality.propagation_error:.2g} relative, flown control integrated: {quality.propagation_location}"
    else:
        miss = f"ends early when the flown control is integrated: {quality.propagation_location}"
    yield _line("propagation", miss)


def _overshoot(solution: SummarisedSolution) -> Iterator[str]:
    for leg in solution.phases.values():
        over = overshooting_controls(leg)
        if not over:
            continue
        units = dict(zip(leg.controls.labels, leg.controls.units, strict=True))
        named = [f"{label} by {amount:.3g} {units[label]}".rstrip() for label, amount in over.items()]
        more = f" and {len(named) - WORST} more" if len(named) > WORST else ""
        yield _line(
            "overshoot",
            f"control polynomials leave their bounds between nodes ({', '.join(named[:WORST])}{more}): "
            "fly saturated_control or refine",
        )


def left_tables(solution: SummarisedSolution) -> list[OutsideTable]:
    """Return where the trajectory is outside of tables; nothing without the problem, which alone knows them."""
    return [] if solution.problem is None else solution.outside_tables()


def _words(value: str) -> str:
    return value.replace("_", " ")


def _line(label: str, text: str) -> str:
    return f"  {label:<{LABEL_WIDTH}}{text}"
