"""Kinks along a phase that cost the more the larger they are, or limit that: which ones, and in which direction."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.model.graph import replaced
from gnc_opt.problem.constraint import Constraint
from gnc_opt.problem.interval import intersect
from gnc_opt.problem.norms.domain import Domain, drawn, is_affine
from gnc_opt.problem.norms.extrema import Pieces, meeting, outermost, pieces, rows_of
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.statement import Statement
from gnc_opt.problem.tables import table_uses
from gnc_opt.tolerances import EQUAL


@dataclass(frozen=True, eq=False)
class Extremum:
    """A kink that an optimum pushes against, as the largest or least of its pieces.

    Attributes
    ----------
    node : casadi.SX
    sense : int
        1 if it is the largest of its pieces and less of it is better, -1 if it is the least and more is better.
    pieces : list of casadi.SX
    """

    node: Any
    sense: int
    pieces: Pieces


def kinks_that_cost(problem: Statement, leg: Phase, domain: Domain) -> dict[str, list[Extremum]]:
    """Return the kinks of the integrands that are convex where less is better, by the names of their integrals."""
    ignored, found = _of_tables(problem, leg), {}
    wanted = integral_senses(problem, leg)
    for name, (_, integrand) in leg.integrands.items():
        nodes = outermost(integrand, ignored, domain) if wanted[name] else []
        if nodes:
            found[name] = list(extrema_of(integrand, nodes, wanted[name], domain))
    return {name: kinks for name, kinks in found.items() if kinks}


def kinks_that_limit(problem: Statement, leg: Phase, domain: Domain) -> dict[tuple[str, int], list[Extremum]]:
    """Return the kinks of path constraints that are convex towards their only limit, by constraint and row."""
    ignored, found = _of_tables(problem, leg), {}
    for name, constraint in leg.paths.items():
        for i, row in enumerate(rows_of(constraint.expression)):
            sense = limited_sense(constraint, i)
            nodes = outermost(row, ignored, domain) if sense else []
            if nodes:
                found[name, i] = list(extrema_of(row, nodes, sense, domain))
    return {place: kinks for place, kinks in found.items() if kinks}


def kinks_that_drain(problem: Statement, leg: Phase, domain: Domain) -> dict[str, list[Extremum]]:
    """Return the kinks of rates of states of which more is better, as fuel, and that fall by them, by state.

    (And the other way round.) That more is better is presumed from costs and limits at the end: where it is not, parts
    of a split control push at once.
    """
    wanted = _state_senses(problem, leg)
    return {
        name: kinks
        for name, rate, nodes in _kinked_rates(problem, leg, domain)
        if wanted[name] and (kinks := list(extrema_of(rate, nodes, wanted[name], domain)))
    }


def kinks_of_rates(problem: Statement, leg: Phase, domain: Domain) -> dict[str, list[Extremum]]:
    """Return all kinks of rates that are the largest, or the least, of pieces, by state."""
    found = {}
    for name, _, nodes in _kinked_rates(problem, leg, domain):
        tried = [(node, sense, pieces(node, sense, domain)) for node in nodes for sense in (1, -1)]
        found[name] = [Extremum(node, sense, own) for node, sense, own in tried if own is not None]
    return found


def _kinked_rates(problem: Statement, leg: Phase, domain: Domain) -> Iterator[tuple[str, Any, list[Any]]]:
    ignored = _of_tables(problem, leg)
    for name, rate in zip(leg.model.states.labels, rows_of(leg.model.derivative()), strict=True):
        nodes = outermost(rate, ignored, domain)
        if nodes:
            yield name, rate, nodes


def _state_senses(problem: Statement, leg: Phase) -> dict[str, int]:
    """Return 1 for states of which less at the end is better, as far as cost and limits tell, -1 for more, else 0."""
    domain, numbers = Domain.at_ends(problem), leg.numbers
    cost = problem.bind(leg, problem.sense * problem.cost)
    senses = {}
    for i, (name, symbol) in enumerate(
        zip(leg.model.states.labels, ca.vertsplit(leg.ends("final")), strict=True)
    ):
        slope = ca.jacobian(cost, symbol)
        end = intersect(numbers.final, numbers.states)
        fills = end.upper[i] > numbers.initial.upper[i]
        limits = int(np.isfinite(end.upper[i]) and fills) - int(np.isfinite(end.lower[i]))
        told = limits * int(end.lower[i] < end.upper[i])  # a given end tells nothing
        senses[name] = told if slope.is_zero() else domain.sign(slope)
    return senses


def limited_sense(constraint: Constraint, row: int) -> int:
    """Return 1 for a row with a limit from above alone, -1 from below alone, else 0."""
    below, above = np.isfinite([constraint.interval.lower[row], constraint.interval.upper[row]])
    return int(above) - int(below)


def extrema_of(expression: Any, nodes: list[Any], sense: int, domain: Domain) -> Iterator[Extremum]:
    """Yield those kinks of a scalar that are convex where less of it (sense 1), or more of it (-1), is better."""
    for node, direction in zip(nodes, domain.directions(expression, nodes), strict=True):
        own = sense * direction
        found = pieces(node, own, domain) if own else None
        if found is not None and len(found) > 1 and not _is_rounded(expression, Extremum(node, own, found)):
            yield Extremum(node, own, found)


def _is_rounded(expression: Any, kink: Extremum) -> bool:
    """Whether an expression has no slope, or no finite one, wherever two pieces of a kink meet: ``fmax(a, 0)**2``."""
    z = ca.SX.sym("z")
    of_z = replaced(expression, {kink.node.element_hash(): z})
    slope = ca.densify(ca.jacobian(of_z, z))
    for first, second in combinations(kink.pieces, 2):
        symbol = next((s for s in ca.symvar(second - first) if is_affine(second - first, s)), None)
        if symbol is None:
            return False
        gap = second - first
        column = ca.vertcat(ca.substitute(slope, z, first), first, *kink.pieces)
        slopes, here, *others = drawn(ca.substitute(column, symbol, meeting(gap, symbol)))
        largest = np.all(kink.sense * (here - np.array(others)) >= -EQUAL, axis=0)
        if np.any(largest & ~np.isfinite(slopes)):
            return True
        if np.any(largest & (np.abs(slopes) > EQUAL)):
            return False
    return True


def integral_senses(problem: Statement, leg: Phase) -> dict[str, int]:
    """Return 1 for integrals of which less is never worse, -1 for more, 0 for both or neither, by name."""
    domain = Domain.at_ends(problem)
    ends = problem.bind(leg, ca.vertcat(problem.sense * problem.cost, problem.constraint_expression()))
    box = problem.constraint_interval()
    lower, upper = np.isfinite(np.append(-np.inf, box.lower)), np.isfinite(np.append(0.0, box.upper))
    senses = {}
    for name, (symbol, _) in leg.integrands.items():
        slopes = ca.jacobian(ends, symbol)
        rows = [i for i in range(ends.numel()) if not slopes[i].is_zero()]
        own = {domain.sign(slopes[i]) * (int(upper[i]) - int(lower[i])) for i in rows}
        senses[name] = own.pop() if len(own) == 1 else 0
    return senses


def _of_tables(problem: Statement, leg: Phase) -> frozenset[int]:
    return frozenset[int]().union(*(use.hashes for use in table_uses(problem, problem.phases[leg.name])))
