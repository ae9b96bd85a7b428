"""Fronts: what less time costs, each point a solved problem with its verdict, beside the published law."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

import gnc_opt as go
from problems.comparison import Row, require

DECADE = 10.0
"""Costs are drawn on a logarithmic axis beyond this ratio; within it, ticks in tens are too few to read."""


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
    told : str
        Conditions of the verdict that fail or cannot be told.
    """

    time: float
    cost: float
    certified: bool
    told: str = ""


@dataclass(frozen=True)
class Front:
    """What less time costs.

    Attributes
    ----------
    cost, unit : str
        Name and unit of what is paid.
    points : tuple of Point
        By increasing time.
    published : tuple of 2 float
        Time (s) and cost of the published law, undisturbed.
    law : str
        Its name.
    """

    cost: str
    unit: str
    points: tuple[Point, ...]
    published: tuple[float, float]
    law: str

    @property
    def paid(self) -> str:
        """What is paid, with its unit, as in tables."""
        return f"{self.cost} ({self.unit})" if self.unit else self.cost

    @property
    def falls(self) -> bool:
        """Whether more time never costs more: what is not so is no front."""
        return bool(np.all(np.diff([point.cost for point in self.points]) <= 0))

    @property
    def excess(self) -> float:
        """What the published law costs over the front at the same time, interpolated; beyond its ends the end's."""
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
        told = ", ".join(c.name for c in (*verdict.failed, *verdict.untold))
        points.append(Point(*measure(solution), verdict.ok, told))
    return tuple(sorted(points, key=lambda point: point.time))


def front_rows(front: Front) -> list[Row]:
    """Return a row per point, and where the published law is."""
    rows = [
        require(
            f"front, {point.time:.6g} s: {front.paid}",
            "certified",
            point.cost,
            point.certified,
            note=point.told,
        )
        for point in front.points
    ]
    costs = [point.cost for point in front.points]
    return [
        *rows,
        require("front: more time costs less", "falls", costs, front.falls),
        require(
            f"front: what the published law ({front.law}) costs over the front at its time",
            "> 1",
            front.excess,
            front.excess > 1.0,
        ),
    ]


def front_figure(front: Front) -> Any:
    """Draw a front: filled where certified, and the publication's point."""
    from gnc_opt.plot.style import axis_label, line_look, new_figure, style, unit_text

    with style():
        figure = new_figure(3.4)
        ax = figure.subplots()
        times, costs = [p.time for p in front.points], [p.cost for p in front.points]
        ax.plot(times, costs, marker="o", label="optimal", **line_look(0))
        for point in front.points:
            if not point.certified:
                ax.plot(point.time, point.cost, "o", mfc="white", mec="black", zorder=3)
        ax.plot(*front.published, "ks", label=front.law)
        shown = [*costs, front.published[1]]
        if max(shown) > DECADE * min(shown):
            ax.set_yscale("log")
        ax.set_xlabel("time (s)")
        ax.set_ylabel(axis_label(unit_text(front.cost), front.unit))
        ax.legend()
    return figure
