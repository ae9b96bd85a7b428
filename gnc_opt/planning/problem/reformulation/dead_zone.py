r"""The form of a phase whose actuators have dead zones: off, or on beyond them.

In a dead zone a control u does nothing but cost, so that it rests where that is cheapest, at :math:`u_0`. To get out of
it an optimum jumps over its edge, a kink of H that is not convex: solvers that begin on one side stay there. So which
side it is on becomes a control, a share :math:`s \in [0, 1]` of what u does beyond the edge, at :math:`c + e`:

.. math::
   f = f(u_0) + s \, (f(c + e) - f(u_0))

(outer convexification; S. Sager, Numerical Methods for Mixed-Integer Optimal Control Problems, Heidelberg 2005). H is
affine in s, which therefore is 0 or 1, and the solution that of the problem as stated; if not, the verdict says so.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.model.composed_controls import SwitchedControl
from gnc_opt.model.expressions import replaced
from gnc_opt.model.variables import Symbol, Variable
from gnc_opt.planning.problem.interval import free
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.reformulation.actuators import DeadZone
from gnc_opt.planning.problem.reformulation.phase_form import PhaseForm, free_name
from gnc_opt.planning.problem.restatement import Restatement

MOST = 1.0 - 1e-9
"""Share of its spread up to which an unbounded excess is told."""


@dataclass(frozen=True, eq=False)
class DeadZoneForm(PhaseForm):
    """A phase with switched controls in place of those with dead zones.

    Attributes
    ----------
    controls : tuple of SwitchedControl
    """

    controls: tuple[SwitchedControl, ...]

    @classmethod
    def of(cls, leg: Phase, dead: dict[str, list[DeadZone]]) -> DeadZoneForm:
        """Restate a phase in shares and excesses."""
        old, layout = leg.model, leg.model.controls
        parts = {name: list(_parts(leg, layout[name], zones[0].shape)) for name, zones in dead.items()}
        switched = [_switched(layout[name], zones, parts[name]) for name, zones in dead.items()]
        whole: dict[int, Any] = {}
        mixed: dict[int, Any] = {}
        for name, zones in dead.items():
            for i, zone in enumerate(zones):
                pieces, u = [p[i] for p in parts[name]], zone.acting.u
                whole[u.element_hash()] = _mixed(u, zone, pieces)
                mixed |= {z.element_hash(): _mixed(z, zone, pieces) for z in zone.acting.nodes}

        def express(expression: Any) -> Any:
            return replaced(expression, {**whole, **mixed})

        stated = ca.vertcat(*(old.symbol(c.name) for c in switched))
        solved = replaced(stated, whole)
        return cls(
            old.in_controls(
                [s for v in layout.variables for s in parts.get(v.name, [old.symbol(v.name)])],
                [(c, replaced(ca.SX(old.symbol(c.name)), whole)) for c in switched],
                express,
            ),
            dict(leg.paths),
            {name: (symbol, express(e)) for name, (symbol, e) in leg.integrands.items()},
            Restatement(
                old,
                stated,
                solved,
                ca.vertcat(*(_values(old.symbol(v.name), dead.get(v.name)) for v in layout.variables)),
                tuple(f"{c.name} is solved for as off, or on beyond its dead zone" for c in switched),
                tuple(c.name for c in switched),
            ),
            tuple(switched),
        )

    def apply(self, leg: Phase) -> None:
        """Give a phase this form with its own numbers."""
        old, new, numbers = leg.model, self.model.controls, leg.numbers
        box, scales = free(new.size), dict(numbers.scales)
        own = {c.name: c for c in self.controls}
        for name in old.controls.names:
            there = old.controls.slice(name)
            lower, upper = numbers.controls.lower[there], numbers.controls.upper[there]
            if name not in own:
                box.lower[new.slice(name)], box.upper[new.slice(name)] = lower, upper
                continue
            shares, excesses = own[name].parts[::2], own[name].parts[1::2]
            for corner, sense, spread, share, excess in zip(
                own[name].corners, own[name].senses, own[name].spreads, shares, excesses, strict=True
            ):
                room = (upper if sense > 0 else -lower) - sense * np.array(corner)
                box.lower[new.slice(share)], box.upper[new.slice(share)] = 0.0, 1.0
                box.lower[new.slice(excess)], box.upper[new.slice(excess)] = (
                    0.0,
                    np.minimum(room, MOST * np.array(spread)),
                )
                if name in scales:
                    scales[excess] = scales[name]
            scales.pop(name, None)
        self.give(leg, replace(numbers, controls=box, scales=scales))


def _parts(leg: Phase, v: Variable, senses: tuple[int, ...]) -> Iterator[Symbol]:
    """Yield the symbols of a share and an excess for each side."""
    for sense in senses:
        side = "above" if sense > 0 else "below"
        yield Symbol(Variable(free_name(leg.model, f"{v.name}_on_{side}"), v.size, ""))
        yield Symbol(Variable(free_name(leg.model, f"{v.name}_{side}"), v.size, v.unit, v.nominal))


def _switched(v: Variable, zones: list[DeadZone], parts: list[Symbol]) -> SwitchedControl:
    return SwitchedControl(
        v,
        tuple(p.variable.name for p in parts),
        tuple(zone.rest for zone in zones),
        tuple(zip(*([corner for _, corner, _ in zone.sides] for zone in zones), strict=True)),
        zones[0].shape,
        tuple(zip(*(zone.spreads for zone in zones), strict=True)),
    )


def _mixed(z: Any, zone: DeadZone, parts: list[Any]) -> Any:
    """Return an expression of the control alone in shares and excesses."""
    u = zone.acting.u
    nothing = replaced(z, {u.element_hash(): ca.SX(zone.rest)})
    value = nothing
    for (sense, corner, span), spread, share, told in zip(
        zone.sides, zone.spreads, parts[::2], parts[1::2], strict=True
    ):
        excess = told / (1.0 - told / spread) if np.isfinite(spread) else told
        there = replaced(zone.acting.on(z, span), {u.element_hash(): corner + sense * excess})
        value += share * (there - nothing)
    return value


def _values(u: Any, zones: list[DeadZone] | None) -> Any:
    """Return new controls in terms of an old one."""
    if zones is None:
        return u
    found = []
    for k, sense in enumerate(zones[0].shape):
        excess = sense * (ca.SX(u) - ca.DM([zone.sides[k][1] for zone in zones]))
        on = excess > 0
        told = excess / (1.0 + excess / ca.DM([zone.spreads[k] for zone in zones]))
        found += [on, ca.if_else(on, told, np.nan)]
    return ca.vertcat(*found)
