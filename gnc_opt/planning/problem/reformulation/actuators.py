"""What actuators of a phase do not do: dead zones, and what lies beyond their saturation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.model.expressions import replaced
from gnc_opt.model.variables import Variable
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.planning.problem.interval_arithmetic import Domain
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.reformulation.pure import Acting, Span, inner
from gnc_opt.planning.problem.reformulation.vector_norms import stated_controls
from gnc_opt.planning.problem.restatement import Restatement
from gnc_opt.planning.problem.statement import Statement
from gnc_opt.tolerances import EQUAL

WIDE = 10.0
"""Spread of an unbounded excess, in units of the largest corner or nominal value."""


@dataclass(frozen=True, eq=False)
class DeadZone:
    """A dead zone of a control component.

    Attributes
    ----------
    acting : Acting
    rest : float
        Where it costs least in it.
    sides : tuple of (sense, corner, span)
        Those beyond it.
    spread : float
        Of excesses without a bound.
    """

    acting: Acting
    rest: float
    sides: tuple[tuple[int, float, Span], ...]
    spread: float

    @property
    def shape(self) -> tuple[Any, ...]:
        """What components of one control have in common."""
        return tuple(sense for sense, _, _ in self.sides)

    @property
    def key(self) -> tuple[Any, ...]:
        """The same for the same form."""
        return (self.rest, *((sense, corner) for sense, corner, _ in self.sides), *self.spreads)

    @property
    def spreads(self) -> tuple[float, ...]:
        """Of each side, infinite where its excess is bounded."""
        return tuple(np.inf if np.all(np.isfinite(span)) else self.spread for _, _, span in self.sides)


@dataclass(frozen=True, eq=False)
class Actuators:
    """What actuators of a phase do not do.

    Attributes
    ----------
    dead : dict of list of DeadZone
        By the control whose components they are.
    bounds : dict of Interval
        By control, of those that are saturated within their bounds.
    within : dict
        Expressions of those alone as they are within these bounds, by the hashes of what they stand for.
    """

    dead: dict[str, list[DeadZone]]
    bounds: dict[str, Interval]
    within: dict[int, Any]

    @classmethod
    def of(cls, problem: Statement, leg: Phase, domain: Domain) -> Actuators:
        """Find it."""
        layout, box = leg.model.controls, leg.numbers.controls
        symbols, stated = ca.vertsplit(leg.model.symbols("control")), {*stated_controls(leg).values()}
        dead: dict[str, list[DeadZone]] = {}
        bounds: dict[str, Interval] = {}
        within: dict[int, Any] = {}
        for v in layout.variables:
            places = range(*layout.slice(v.name).indices(layout.size))
            own = [Acting.of(problem, leg, symbols[i]) for i in places if i in stated]
            actings = [a for a in own if a is not None]
            if not actings or len(actings) < v.size:
                continue
            spans = [
                _useful(a, box.lower[i], box.upper[i], domain) for a, i in zip(actings, places, strict=True)
            ]
            if any(
                (s[0][0], s[-1][1]) != (box.lower[i], box.upper[i])
                for s, i in zip(spans, places, strict=True)
            ):
                bounds[v.name] = Interval(
                    np.array([s[0][0] for s in spans]), np.array([s[-1][1] for s in spans])
                )
                for acting, (first, *others) in zip(actings, spans, strict=True):
                    if not others:
                        within |= {z.element_hash(): acting.on(z, first) for z in acting.rates}
            zones = [_dead_zone(a, s, v, domain) for a, s in zip(actings, spans, strict=True)]
            found = [zone for zone in zones if zone is not None]
            costs = all(
                a.costs for a in actings
            )  # what costs nothing may rest anywhere: no edge keeps solvers
            if costs and len(found) == v.size and len({zone.shape for zone in found}) == 1:
                dead[v.name] = found
        return cls(dead, bounds, within)

    @property
    def key(self) -> tuple[Any, ...]:
        """The same for the same form."""
        dead = ((name, *(zone.key for zone in zones)) for name, zones in self.dead.items())
        return (*dead, *self.bounds)

    def bound(self, leg: Phase) -> None:
        """Give controls the bounds beyond which they do nothing but cost."""
        box, layout = leg.numbers.controls, leg.model.controls
        box = Interval(box.lower.copy(), box.upper.copy())
        for name, own in self.bounds.items():
            box.lower[layout.slice(name)], box.upper[layout.slice(name)] = own.lower, own.upper
        leg.numbers = replace(leg.numbers, controls=box)
        model = leg.model
        if self.within:
            symbols = [model.symbol(name) for name in model.controls.names]
            leg.model = model.in_controls(symbols, [], lambda e: replaced(e, self.within))
        texts = tuple(f"{name} is solved for within the bounds where it saturates" for name in self.bounds)
        leg.restatement = Restatement.of_limits(model, texts).after(leg.restatement)


def _useful(acting: Acting, lower: float, upper: float, domain: Domain) -> list[Span]:
    """Return the spans of a control without those at its ends in which it does nothing, and costs the more."""
    spans = acting.spans(lower, upper)
    while len(spans) > 1 and acting.does_nothing(spans[-1]) and acting.rises(spans[-1][0], domain) > 0:
        spans.pop()
    while len(spans) > 1 and acting.does_nothing(spans[0]) and acting.rises(spans[0][1], domain) in (-1, 2):
        spans.pop(0)
    return spans


def _dead_zone(acting: Acting, spans: list[Span], v: Variable, domain: Domain) -> DeadZone | None:
    """Return the only dead zone of a control; None without one, or with several, or if both sides could be on."""
    dead = [span for span in spans if acting.does_nothing(span)]
    if not dead or len(dead) == len(spans) or any(a[1] != b[0] for a, b in pairwise(dead)):
        return None
    first, last = dead[0][0], dead[-1][1]
    rest = _cheapest(acting, (first, last), spans, domain)
    beyond = [(1, last, span) for span in spans if span[0] == last]
    beyond += [(-1, first, span) for span in spans if span[1] == first]
    if rest is None or len(beyond) + len(dead) < len(spans) or not _opposed(acting, rest, beyond):
        return None
    spread = max(*map(abs, acting.corners), *(v.nominal or (1.0,)))
    return DeadZone(acting, rest, tuple(beyond), WIDE * spread)


def _cheapest(acting: Acting, dead: Span, spans: list[Span], domain: Domain) -> float | None:
    """Return where in its dead zone a control costs least; None if that is not known."""
    lower, upper = dead
    here = min(max(0.0, lower), upper)
    found = acting.rises(here, domain)
    at_end = {1: spans[0][0], -1: spans[-1][1]}.get(found)
    return here if found == 2 or here == at_end else None


def _opposed(acting: Acting, rest: float, sides: list[tuple[int, float, Span]]) -> bool:
    """Whether what sides do is one vector, and of two sides opposed: so never are both worth their cost."""
    nothing = acting.values(rest)
    done = [(sense, acting.values(inner(span)) - nothing) for sense, _, span in sides]
    size = [sense * what / np.linalg.norm(what) for sense, what in done]
    return all(np.allclose(size[0], other, atol=EQUAL) for other in size)
