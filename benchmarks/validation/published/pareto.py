"""Fronts: what less time costs, each point a verified optimum, beside the published controller."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

import gnc_opt as go
from benchmarks.validation.published.comparison import Claim, Row


@dataclass(frozen=True)
class Point:
    """One solved problem.

    Attributes
    ----------
    time : float
        s.
    cost : float
        In the front's unit.
    certified : bool
        Whether its verdict is ok.
    failing : str
        Conditions of the verdict that fail or are inconclusive.
    """

    time: float
    cost: float
    certified: bool
    failing: str = ""


@dataclass(frozen=True)
class Front:
    """What less time costs.

    Attributes
    ----------
    cost : str
        Its name with its unit.
    points : tuple of Point
        By increasing time.
    published : tuple of 2 float
        Time (s) and cost of the published controller, undisturbed.
    law : str
        Its name.
    """

    cost: str
    points: tuple[Point, ...]
    published: tuple[float, float]
    law: str

    @property
    def falls(self) -> bool:
        """Whether more time never costs more: otherwise it is no front."""
        return bool(np.all(np.diff([point.cost for point in self.points]) <= 0))

    @property
    def excess(self) -> float:
        """Cost of the published controller over the front's at the same time; beyond its ends, over its end's."""
        at, cost = self.published
        times, costs = (np.array([getattr(p, name) for p in self.points]) for name in ("time", "cost"))
        return float(cost / np.exp(np.interp(np.log(at), np.log(times), np.log(costs))))


def certified(
    parameters: Iterable[float],
    solve: Callable[[float], go.Solution],
    measure: Callable[[go.Solution], tuple[float, float]],
) -> tuple[Point, ...]:
    """Return a point per parameter, by increasing time.

    Parameters
    ----------
    parameters : iterable of float
    solve : callable
        From a parameter to the solution.
    measure : callable
        Of a solution: time (s) and cost.
    """
    points = []
    for parameter in parameters:
        solution = solve(parameter)
        verdict = go.verify(solution)
        points.append(Point(*measure(solution), verdict.ok, failing(verdict)))
    return tuple(sorted(points, key=lambda point: point.time))


def failing(verdict: go.Verdict) -> str:
    """Return the conditions that fail or are inconclusive."""
    return ", ".join(c.name for c in (*verdict.failed, *verdict.inconclusive))


def front_rows(front: Front) -> Iterator[Row]:
    """Yield a row per point, and where the published controller is."""
    for point in front.points:
        verdict = Claim("certified", point.certified)
        yield Row(
            f"front, {point.time:.6g} s: {front.cost}", (point.cost,), None, verdict, note=point.failing
        )
    costs = tuple(point.cost for point in front.points)
    yield Row("front: more time costs less", costs, None, Claim("falls", front.falls))
    quantity = f"front: what the published law ({front.law}) costs over the front at its time"
    yield Row(quantity, (front.excess,), None, Claim("> 1", front.excess > 1.0))
