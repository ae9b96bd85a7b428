"""The verdict: condition by condition, with numbers, places and meanings."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from gnc_opt.errors import unknown_name


class Result(Enum):
    """Outcome of one condition."""

    PASS = "PASS"
    FAIL = "FAIL"
    CANNOT_TELL = "CANNOT TELL"


@dataclass(frozen=True)
class Condition:
    """One necessary condition and how well it holds.

    Attributes
    ----------
    name : str
    result : Result
    value : float
        The worst offence, dimensionless (see ``meaning``).
    tolerance : float
        Largest value that passes.
    where : str
        Phase, time and quantity of the worst offence.
    meaning : str
        What the condition says and what its failure means, in one or two sentences.
    """

    name: str
    result: Result
    value: float
    tolerance: float
    where: str
    meaning: str


@dataclass(frozen=True)
class Verdict:
    """All conditions of a solution.

    Attributes
    ----------
    problem_name : str
    conditions : tuple of Condition
    not_judged : str
        Why nothing of the minimum principle could be judged: "no costates"; empty if it was.
    """

    problem_name: str
    conditions: tuple[Condition, ...]
    not_judged: str = ""

    @property
    def ok(self) -> bool:
        """Whether no condition fails and the minimum principle was judged.

        Single conditions that cannot be told do not fail; see ``proven``.
        """
        return not self.failed and not self.not_judged

    @property
    def proven(self) -> bool:
        """Whether every condition passes."""
        return all(c.result is Result.PASS for c in self.conditions)

    @property
    def failed(self) -> tuple[Condition, ...]:
        """The conditions that fail."""
        return tuple(c for c in self.conditions if c.result is Result.FAIL)

    @property
    def word(self) -> str:
        """The verdict in a word or two: "ok", "NOT ok" or "not judged: no costates"."""
        if self.failed:
            return "NOT ok"
        return f"not judged: {self.not_judged}" if self.not_judged else "ok"

    def __getitem__(self, name: str) -> Condition:
        for condition in self.conditions:
            if condition.name == name:
                return condition
        names = [c.name for c in self.conditions]
        raise unknown_name("condition", name, f"the verdict on '{self.problem_name}'", names)

    def explain(self) -> str:
        """Return a paragraph per condition that does not pass, or one that says all do."""
        word = "every condition passes" if self.proven else self.word
        lines = [f"Verdict on '{self.problem_name}': {word}."]
        for c in self.conditions:
            if c.result is not Result.PASS:
                lines.append(
                    f"{c.result.value}  {c.name}: {c.value:.2e} (tolerance {c.tolerance:.0e}) at {c.where}. {c.meaning}"
                )
        return "\n".join(lines)

    def __str__(self) -> str:
        width = max(len(c.name) for c in self.conditions)
        lines = [
            f"{c.name:<{width}}  {c.result.value:<11}  {c.value:9.2e}  {c.where}" for c in self.conditions
        ]
        return "\n".join([*lines, f"verdict: {self.word}"])
