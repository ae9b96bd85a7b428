"""The form of a phase without absolute values of controls: each is the sum of two that push one way."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from gnc_opt.model.composed import SplitControl
from gnc_opt.model.graph import nodes_of
from gnc_opt.model.layout import Variable
from gnc_opt.model.model import Model
from gnc_opt.model.norms import NormNodes
from gnc_opt.model.symbol import Symbol
from gnc_opt.problem.constraint import Constraint
from gnc_opt.problem.interval import Interval, free
from gnc_opt.problem.norms.find import stated_controls
from gnc_opt.problem.norms.limits import allows_shorter
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.restatement import Restatement
from gnc_opt.problem.statement import Statement
from gnc_opt.problem.tables import along

CORNERS = (ca.OP_FABS, ca.OP_SQRT, ca.OP_FMAX)
"""Operations by which absolute values are written."""

Names: TypeAlias = tuple[str, ...]


def absolute_controls(problem: Statement, leg: Phase) -> Names:
    """Return the controls of which all components have absolute values that are sums of two parts at an optimum.

    So it is where less is better: in a cost, and in a limit from above.
    """
    model, stated = leg.model, stated_controls(leg)
    symbols = ca.vertsplit(model.symbols("control"))
    corners = [node for node in nodes_of(along(leg)) if node.op() in CORNERS]
    found = {
        i
        for h, i in stated.items()
        if _has_corner(corners, symbols[i], h) and _less_is_better(problem, leg, symbols[i])
    }
    whole = []
    for v in model.controls.variables:
        places = model.controls.slice(v.name)
        if found.issuperset(range(*places.indices(model.controls.size))):
            whole.append(v.name)
    return tuple(whole)


def _has_corner(corners: list[Any], symbol: Any, place: int) -> bool:
    for node in corners:
        if any(s.element_hash() == place for s in ca.symvar(node)):
            norms = NormNodes.of(node, symbol)
            if norms.degrees.get(node.element_hash()) == 1:
                return True
    return False


def _less_is_better(problem: Statement, leg: Phase, symbol: Any) -> bool:
    """Whether the absolute value is in no rate, in no limit from below and, in integrals, in a cost alone."""
    size = ca.SX.sym("size")
    norms = NormNodes.of(along(leg), symbol)

    def of_size(expression: Any) -> Any:
        return absolute(norms).replaced(expression, size, {})

    if ca.depends_on(of_size(leg.model.derivative()), size):
        return False
    box = leg.path_interval()
    for i, row in enumerate(ca.vertsplit(leg.path_expression()) if leg.paths else ()):
        limits = Interval(box.lower[i : i + 1], box.upper[i : i + 1])
        value = of_size(row)
        if ca.depends_on(value, size) and not allows_shorter(value, size, limits):
            return False
    upwards = Interval(np.full(1, -np.inf), np.zeros(1))
    for integral, integrand in leg.integrands.values():
        value = of_size(integrand)
        if not ca.depends_on(value, size):
            continue
        weight = ca.jacobian(problem.sense * problem.cost, integral)
        elsewhere = ca.depends_on(problem.constraint_expression(), integral)
        if (
            elsewhere
            or not weight.is_constant()
            or float(weight) <= 0
            or not allows_shorter(value, size, upwards)
        ):
            return False
    return True


def absolute(norms: NormNodes) -> NormNodes:
    """Return them without squares, which are smooth."""
    return replace(norms, degrees={h: d for h, d in norms.degrees.items() if d == 1})


@dataclass(frozen=True, eq=False)
class SplitForm:
    """A phase with split controls in place of some controls.

    Attributes
    ----------
    key : tuple of str
        Names of the controls.
    model : Model
    paths : dict of Constraint
    integrands : dict of (symbol, expression)
    restatement : Restatement
    controls : tuple of SplitControl
    """

    key: Names
    model: Model
    paths: dict[str, Constraint]
    integrands: dict[str, tuple[Any, Any]]
    restatement: Restatement
    controls: tuple[SplitControl, ...]

    @classmethod
    def of(cls, leg: Phase, names: Names) -> SplitForm:
        """Restate a phase in the two parts of some of its controls."""
        old = leg.model
        parts = {name: _parts(old, old.controls[name]) for name in names}
        splits = tuple(
            SplitControl(old.controls[name], (plus.variable.name, minus.variable.name))
            for name, (plus, minus) in parts.items()
        )
        instead, norms = {}, []
        outputs = [old.output_expression(name) for name in old.outputs.names]
        everything = ca.vertcat(along(leg), *outputs)
        for name, (plus, minus) in parts.items():
            for symbol, p, m in zip(*map(ca.vertsplit, (old.symbol(name), plus, minus)), strict=True):
                instead[symbol.element_hash()] = p - m
                norms.append((absolute(NormNodes.of(everything, symbol)), p + m))

        def express(expression: Any) -> Any:
            for nodes, size in norms:
                expression = nodes.replaced(expression, size, {})
            return NormNodes(ca.SX(0, 1), {}).replaced(expression, None, instead)

        controls = list(_new_controls(old, parts))
        composed = [
            (c, old_value) for c, old_value in zip(splits, (p - m for p, m in parts.values()), strict=True)
        ]
        lengths = {v.length for v in leg.vectors}
        stated = ca.vertcat(*(old.symbol(name) for name in names))
        return cls(
            names,
            old.in_controls(controls, composed, express),
            {
                name: c if name in lengths else replace(c, expression=express(c.expression))
                for name, c in leg.paths.items()
            },
            {name: (symbol, express(e)) for name, (symbol, e) in leg.integrands.items()},
            Restatement(
                old,
                stated,
                express(stated),
                tuple(
                    f"{c.name} is solved for as {' - '.join(c.parts)}, |{c.name}| as their sum"
                    for c in splits
                ),
            ),
            splits,
        )

    def apply(self, leg: Phase) -> Names:
        """Give a phase this form with its own numbers."""
        old, new, numbers = leg.model, self.model.controls, leg.numbers
        box, scales = free(new.size), dict(numbers.scales)
        for name in new.names:
            if name in old.controls:
                place, there = new.slice(name), old.controls.slice(name)
                box.lower[place], box.upper[place] = (
                    numbers.controls.lower[there],
                    numbers.controls.upper[there],
                )
        for control in self.controls:
            there = old.controls.slice(control.name)
            lower, upper = numbers.controls.lower[there], numbers.controls.upper[there]
            for part, ends in zip(control.parts, ((lower, upper), (-upper, -lower)), strict=True):
                box.lower[new.slice(part)], box.upper[new.slice(part)] = (
                    np.maximum(end, 0.0) for end in ends
                )
                if control.name in scales:
                    scales[part] = scales[control.name]
            scales.pop(control.name, None)
        values = {
            v.name: old.parameter_values[old.parameters.slice(v.name)] for v in old.parameters.variables
        }
        leg.model = self.model.with_parameters(**values)
        leg.numbers = replace(numbers, controls=box, scales=scales)
        leg.paths, leg.integrands = dict(self.paths), dict(self.integrands)
        leg.restatement = self.restatement.after(leg.restatement)
        return ()


def _parts(model: Model, variable: Variable) -> tuple[Symbol, Symbol]:
    taken = {
        n for names in (model.states, model.controls, model.parameters, model.outputs) for n in names.names
    }

    def part(what: str) -> Symbol:
        name = f"{variable.name}_{what}"
        while name in taken:
            name += "_"
        return Symbol(replace(variable, name=name))

    return part("plus"), part("minus")


def _new_controls(model: Model, parts: dict[str, tuple[Symbol, Symbol]]) -> Iterator[Symbol]:
    for v in model.controls.variables:
        yield from parts.get(v.name, (model.symbol(v.name),))
