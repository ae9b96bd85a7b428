"""Verdict: results of the optimality conditions with values, locations and meanings; lower bound of the cost.

`gnc_opt.planning.verification` evaluates the conditions.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Enum

from gnc_opt.errors import unknown_name_error
from gnc_opt.text_html_and_json_formatting import PrintableResult, read_status_explanations


@dataclass(frozen=True)
class LowerBound(PrintableResult):
    """Minimum of the problem itself or of a relaxation, as a lower bound of its cost.

    Attributes
    ----------
    value : float
        Bound in the sense of the objective: lower bound of a minimum, upper bound of a maximum.
    states : tuple of str
        State components in the relaxation; all for the problem itself.
    theorem : str
        Theorem that certifies a global minimum of the relaxation. Empty if none applies: the value is then a local
        minimum and a bound only if it is global.

    Examples
    --------
    >>> bound = go.lower_bound(solution).bound
    >>> print(f"{bound.value:.6f}", bound.states, bound.certified)
    2.000000 ('q', 'v') True
    """

    value: float
    states: tuple[str, ...]
    theorem: str

    @property
    def certified(self) -> bool:
        """Whether a theorem certifies the value as a global minimum, up to the tolerances of verdict and solver."""
        return bool(self.theorem)

    def __str__(self) -> str:
        local = "a local minimum, no bound if the subsystem has a lower one"
        text = f"global minimum: {self.theorem}" if self.certified else local
        return f"{self.value:.10g} from the subsystem {', '.join(self.states)} ({text})"


GROUPS = {
    "feasible": ("dynamics", "limits", "boundary conditions", "cost"),
    "first-order conditions": ("stationarity", "active set", "minimum principle", "kinks"),
    "second-order conditions": ("second order", "switching times"),
}
"""Conditions in each group of the summary."""

FIRST_ORDER = (*GROUPS["feasible"], *GROUPS["first-order conditions"][:3])
"""Conditions with a common tolerance."""

REMEDIES = read_status_explanations("condition")
"""Remedy for each failed condition."""


class ConditionResult(Enum):
    """Result of a condition."""

    PASS = "PASS"
    FAIL = "FAIL"
    INCONCLUSIVE = "INCONCLUSIVE"


@dataclass(frozen=True)
class Condition(PrintableResult):
    """Optimality condition and its residual.

    Attributes
    ----------
    name : str
    result : ConditionResult
    value : float
        Largest violation, dimensionless (see ``meaning``).
    tolerance : float
        Largest value that passes.
    where : str
        Phase, time and quantity of the largest violation.
    meaning : str
        Condition and meaning of its failure, in one or two sentences.
    sufficient : bool
        False: necessary for a minimum; ``Verdict.ok`` requires it to pass. True: part of the sufficient conditions of a
        strict local minimum; only ``Verdict.minimum`` requires it to pass. FAIL then means that the necessary form is
        violated too, INCONCLUSIVE that the margin is too small or that no test applies.
    loss : float or None
        First-order cost of the violations along the whole trajectory, in units of the cost; None if unknown.
    unit : str
        Unit of the loss; empty if unknown.

    Examples
    --------
    >>> condition = go.verify(solution)["stationarity"]
    >>> print(condition.result.value, condition.value < condition.tolerance)
    PASS True
    """

    name: str
    result: ConditionResult
    value: float
    tolerance: float
    where: str
    meaning: str
    sufficient: bool = False
    loss: float | None = None
    unit: str = ""

    @property
    def location_text(self) -> str:
        """Location of the largest violation and, if known, the loss of cost: "phase leg, t = 1 s; costs 0.02 s"."""
        return f"{self.where}; costs {self.loss:.2g} {self.unit}".rstrip() if self.loss else self.where


@dataclass(frozen=True)
class Verdict(PrintableResult):
    """Results of all optimality conditions of a solution.

    Attributes
    ----------
    problem_name : str
    conditions : tuple of Condition
    not_checked : str
        Reason why the minimum principle was not checked, for example "no costates"; empty if it was.
    estimated : bool
        Whether costates and multipliers are estimated, because the trajectory has none (`verify_trajectory`).
    bound : LowerBound or None
        Lower bound of the cost of all trajectories, if known (`lower_bound`).
    gap : float or None
        Distance of the objective from the bound, relative to the objective.
    solver_failure : str
        Status of the solver and remedy, if it found no solution; empty otherwise.

    Examples
    --------
    >>> verdict = go.verify(solution)
    >>> print(verdict.outcome, len(verdict.failed))
    ok 0
    """

    problem_name: str
    conditions: tuple[Condition, ...]
    not_checked: str = ""
    estimated: bool = False
    bound: LowerBound | None = None
    gap: float | None = None
    solver_failure: str = ""

    @property
    def ok(self) -> bool:
        """Whether the necessary conditions of a minimum hold: none fails or is inconclusive."""
        return not self.failed and not self.not_checked and all(c.sufficient for c in self.inconclusive)

    @property
    def minimum(self) -> bool:
        """Whether all sufficient conditions hold too: a strict local minimum, within the tolerance."""
        checked = any(c.sufficient for c in self.conditions)
        return self.ok and checked and not self.inconclusive

    @property
    def smallest_tolerance(self) -> float:
        """Smallest tolerance at which the first-order conditions hold; infinite without costates."""
        values = [c.value for c in self.conditions if c.name in FIRST_ORDER]
        return max((math.inf if math.isnan(v) else v for v in values), default=math.inf)

    @property
    def failed(self) -> tuple[Condition, ...]:
        """Failed conditions."""
        return tuple(c for c in self.conditions if c.result is ConditionResult.FAIL)

    @property
    def inconclusive(self) -> tuple[Condition, ...]:
        """Inconclusive conditions."""
        return tuple(c for c in self.conditions if c.result is ConditionResult.INCONCLUSIVE)

    @property
    def open_conditions(self) -> tuple[Condition, ...]:
        """Conditions that prevent ``ok``: failed ones, followed by inconclusive necessary ones."""
        return (*self.failed, *(c for c in self.inconclusive if not c.sufficient))

    @property
    def outcome(self) -> str:
        """Short form: "ok", "NOT ok", "not checked: no costates" or "inconclusive: stationarity"."""
        if self.failed:
            return "NOT ok"
        if self.not_checked:
            return f"not checked: {self.not_checked}"
        undecided = ", ".join(c.name for c in self.inconclusive if not c.sufficient)
        return f"inconclusive: {undecided}" if undecided else "ok"

    @property
    def headline(self) -> str:
        """Verdict in one sentence: failed conditions, or whether a minimum is certified; distance from a bound."""
        gap = ""
        if self.bound is not None and self.gap is not None:
            of_what = "the global optimum" if self.bound.certified else "a local minimum of a relaxation"
            gap = f"; {'at most ' * self.bound.certified}{abs(self.gap):.1e} from {of_what}"
        if self.minimum:
            return f"every condition passes: a strict local optimum{gap}"
        if self.ok:
            return f"ok: the necessary conditions hold, the sufficient ones are not confirmed{gap}"
        failed = ", ".join(c.name for c in self.failed)
        return self.outcome + f": {failed} {'fails' if len(self.failed) == 1 else 'fail'}" * bool(failed)

    def __getitem__(self, name: str) -> Condition:
        for condition in self.conditions:
            if condition.name == name:
                return condition
        names = [c.name for c in self.conditions]
        raise unknown_name_error("condition", name, f"the verdict on '{self.problem_name}'", names)

    def explain(self) -> str:
        """Return a paragraph per condition that does not pass, or the statement that all pass."""
        note = " (multipliers estimated)" if self.estimated else ""
        lines = [f"Verdict on '{self.problem_name}'{note}: {self.headline}."]
        for c in self.conditions:
            if c.result is not ConditionResult.PASS:
                size = "" if math.isnan(c.value) else f"{c.value:.2e} (tolerance {c.tolerance:.0e}) at "
                lines.append(f"{c.result.value}  {c.name}: {size}{c.location_text}. {c.meaning}")
        return "\n".join(lines)

    def table(self) -> str:
        """Return all conditions, one per line: name, result, value, location of the largest violation."""
        rows = [(c.name, c, c.location_text) for c in self.conditions]
        return "\n".join([*_format_condition_table("condition", rows), f"verdict: {self.outcome}"])

    def __str__(self) -> str:
        """Return failures with remedies, the worst condition of each group, and the verdict."""
        groups, unmet = self.condition_groups, self.open_conditions
        failing = next((found for found in groups.values() if any(c in unmet for c in found)), [])
        lines = [f"no solution, status {self.solver_failure}"] * bool(self.solver_failure)
        lines += [line for c in failing if c in unmet for line in self._explain_condition(c)]
        others = ", ".join(c.name for c in unmet if c not in failing)
        lines += [f"also: {others}"] * bool(others)
        worst = {group: find_worst_optimality_condition(found) for group, found in groups.items()}
        locations = [replace(c, where=c.where.partition(";")[0]).location_text for c in worst.values()]
        rows = [(g, c, f"{c.name}: {place}") for (g, c), place in zip(worst.items(), locations, strict=True)]
        return "\n".join([*lines, *_format_condition_table("group", rows), f"verdict: {self.outcome}"])

    def _explain_condition(self, condition: Condition) -> list[str]:
        """Return result, location, loss of cost and remedy of a condition that does not pass, one per line."""
        size = f"{condition.value:.1e} (tolerance {condition.tolerance:.0e})"
        lines = [f"{condition.result.value} {condition.name}: {size}", f"  at {condition.where}"]
        if condition.loss is not None:
            lines.append(f"  costs {condition.loss:.2g} {condition.unit}".rstrip())
        sample_key = f"{condition.name} of samples" if self.estimated else ""
        remedy = REMEDIES.get(sample_key, REMEDIES.get(condition.name))
        return [*lines, f"  {remedy}"] if remedy and not self.solver_failure else lines

    @property
    def condition_groups(self) -> dict[str, list[Condition]]:
        """Conditions by group: feasibility, first order, second order; others form a group each."""
        group_by_name = {name: group for group, names in GROUPS.items() for name in names}
        groups: dict[str, list[Condition]] = {}
        for c in self.conditions:
            groups.setdefault(group_by_name.get(c.name, c.name), []).append(c)
        return groups

    def __repr__(self) -> str:
        return f"<verdict on '{self.problem_name}': {self.outcome}>"


SEVERITY = {ConditionResult.FAIL: 0, ConditionResult.INCONCLUSIVE: 1, ConditionResult.PASS: 2}


def find_worst_optimality_condition(conditions: Iterable[Condition]) -> Condition:
    """Return the failed, or else inconclusive, condition with the largest nonzero value."""
    return min(
        conditions,
        key=lambda c: (SEVERITY[c.result], c.value == 0.0, math.inf if math.isnan(c.value) else -c.value),
    )


def format_violation(value: float) -> str:
    """Return two digits of a violation, "-" for zero; a negative value is the margin of a sufficient condition."""
    if math.isnan(value) or value == 0.0:
        return "0" if value == 0.0 else "-"
    return f"margin {-value:.1e}" if value < 0.0 else f"{value:.1e}"


def _format_condition_table(title: str, rows: list[tuple[str, Condition, str]]) -> list[str]:
    cells = [(title, "result", "violation", "location")]
    cells += [(name, c.result.value, format_violation(c.value), place) for name, c, place in rows]
    width, wide = (max(len(row[i]) for row in cells) for i in (0, 2))
    return [f"{name:<{width}}  {result:<12}  {value:>{wide}}  {at}" for name, result, value, at in cells]
