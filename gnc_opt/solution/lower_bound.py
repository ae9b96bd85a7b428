"""A bound of the cost that no trajectory of a problem can pass."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LowerBound:
    """The least cost of a problem whose trajectories include all those of another, or seem to.

    Attributes
    ----------
    value : float
        As the objective is stated: what a minimised one is at least, a maximised one at most.
    states : tuple of str
        The components of states that are left in the problem that gives the bound; all where it is the problem itself.
    theorem : str
        By which the minimum of that problem is a global one. Empty where none applies: the minimum is a local one then,
        and the value no bound if another is lower.

    Examples
    --------
    >>> bound = go.bound_below(solution).bound
    >>> print(f"{bound.value:.6f}", bound.states, bound.certified)
    2.000000 ('q', 'v') True
    """

    value: float
    states: tuple[str, ...]
    theorem: str

    @property
    def certified(self) -> bool:
        """Whether a theorem says that the value is a global minimum, up to the tolerances of verdict and solver."""
        return bool(self.theorem)

    def __str__(self) -> str:
        local = "a local minimum of theirs, no bound if another is lower"
        known = f"global, {self.theorem}" if self.certified else local
        return f"{self.value:.10g} by {', '.join(self.states)} ({known})"
