"""Which norms of controls a phase has by hand."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeAlias

import casadi as ca

from gnc_opt.model.graph import nodes_of
from gnc_opt.model.norms import ROOTS, NormNodes
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.norms.limits import limiting_control, limits_of
from gnc_opt.problem.norms.roots import without_roots
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.tables import along

Places: TypeAlias = tuple[int, ...]
"""Of components among the controls."""


def norm_by_hand(leg: Phase) -> Places | None:
    """Return the components of the largest vector whose norm has to be restated; None if there is none."""
    return max([*_under_roots(leg), *_squared(leg)], key=len, default=None)


def stated_controls(leg: Phase) -> dict[int, int]:
    """Return the places of the control components that are no parts of composed ones, by the hash of their symbols."""
    model = leg.model
    parts = {part for composed in model.composed_controls.values() for part in composed.parts}
    taken = {i for part in parts for i in range(*model.controls.slice(part).indices(model.controls.size))}
    symbols = ca.vertsplit(model.symbols("control"))
    return {s.element_hash(): i for i, s in enumerate(symbols) if i not in taken}


def guessed_controls(leg: Phase) -> frozenset[str]:
    """Return the controls that the user's guess knows."""
    return frozenset(name for name in leg.numbers.guess.values if name in leg.model.controls)


def _under_roots(leg: Phase) -> Iterator[Places]:
    """Yield vectors of which a root is the norm: there it has no derivative at zero."""
    stated, tried = stated_controls(leg), set()
    controls = leg.model.symbols("control")
    for node in nodes_of(along(leg)):
        if node.op() not in ROOTS:
            continue
        hashes = [s.element_hash() for s in ca.symvar(node)]
        places = tuple(sorted(stated[h] for h in hashes if h in stated))
        if len(places) > 1 and places not in tried:
            tried.add(places)
            is_norm = NormNodes.of(node, controls[list(places)]).degrees.get(node.element_hash()) == 1
            if is_norm and not (_curves(leg, places) and _is_limited_only(leg, places)):
                yield places


def _curves(leg: Phase, places: Places) -> bool:
    """Whether an integrand curves in all components of a vector, so that an optimum passes through zero smoothly."""
    vector = leg.model.symbols("control")[list(places)]
    hessians = (ca.hessian(row, vector)[0] for row in ca.vertsplit(leg.integrand_expression()))
    return any(
        all(h[i, i].is_constant() and not h[i, i].is_zero() for i in range(len(places))) for h in hessians
    )


def _is_limited_only(leg: Phase, places: Places) -> bool:
    """Whether roots of a vector's components are in upper limits alone, which do without (module `roots`)."""
    own = {leg.model.symbols("control")[i].element_hash() for i in places}
    elsewhere = ca.vertcat(leg.model.derivative(), leg.integrand_expression())
    with_root = [
        node for node in nodes_of(elsewhere) if node.op() in ROOTS and own & {*map(_hash, ca.symvar(node))}
    ]
    changed = without_roots(leg)
    rows = ca.vertcat(*(changed.get(name, c).expression for name, c in leg.paths.items()))
    left = [node for node in nodes_of(rows) if node.op() in ROOTS and own & {*map(_hash, ca.symvar(node))}]
    return not with_root and not left


def _hash(symbol: Any) -> int:
    return int(symbol.element_hash())


def _squared(leg: Phase) -> Iterator[Places]:
    """Yield vectors whose squared norm is limited where its slope vanishes, or from below and nobody guessed them.

    A guess beyond a limit from below is out of its hole, where derivatives lead on.
    """
    guessed = guessed_controls(leg)
    names = [v.name for v in leg.model.controls.variables for _ in range(v.size)]
    stated, controls = set(stated_controls(leg).values()), leg.model.symbols("control")
    box = leg.path_interval()
    size = ca.SX.sym("size")
    for row, expression in enumerate(ca.vertsplit(leg.path_expression()) if leg.paths else ()):
        places = tuple(i for i in _equal_squares(expression, controls) if i in stated)
        if len(places) < 2:
            continue
        of_size = NormNodes.of(expression, controls[list(places)]).replaced(expression, size, {})
        limits = Interval(box.lower[row : row + 1], box.upper[row : row + 1])
        own = limits_of(of_size, size, limits)
        hole = own is not None and 0 < own[0] < own[1] and not any(names[i] in guessed for i in places)
        if hole or (own is None and limiting_control(leg, of_size, size, limits) is not None):
            yield places


def _equal_squares(expression: Any, controls: Any) -> Places:
    """Return the controls whose squares an expression holds with one constant factor, and which are nowhere else."""
    hessian, gradient = ca.hessian(expression, controls)
    slopes = ca.substitute(gradient, controls, ca.SX.zeros(controls.numel()))
    groups: dict[float, list[int]] = {}
    for i in range(controls.numel()):
        row = ca.sparsify(hessian[i, :])
        if row.nnz() == 1 and row.is_constant() and slopes[i].is_zero():
            groups.setdefault(float(ca.DM(row[0, i])), []).append(i)
    return max((tuple(places) for factor, places in groups.items() if factor != 0), key=len, default=())
