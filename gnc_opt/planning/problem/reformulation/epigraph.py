r"""Epigraph form: a kink of the cost becomes a control or free parameter above its smooth pieces.

The smallest s above all of :math:`e_0, \ldots, e_k` is their maximum (S. Boyd & L. Vandenberghe, Convex Optimization,
Cambridge 2004, section 4.1.3). A limit of a kink becomes a limit of each of its pieces.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from gnc_opt.model.casadi_expression_graph import (
    collect_casadi_operation_codes,
    iterate_subexpressions,
    replace_subexpressions_by_hash,
)
from gnc_opt.model.model_variables import Symbol, Variable
from gnc_opt.numerical_tolerances import EQUAL
from gnc_opt.planning.problem.bounds import Interval, stack_intervals
from gnc_opt.planning.problem.constraints import Constraint
from gnc_opt.planning.problem.interval_arithmetic import SymbolRanges, is_affine, sample_expression_randomly
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.phase_bounds_and_guess import ControlMap, PhaseGuess
from gnc_opt.planning.problem.problem_definition import ProblemData
from gnc_opt.planning.problem.reformulation.reformulated_controls import (
    ReformulatedPhase,
    build_guess_of_expression,
    choose_unused_variable_name,
)
from gnc_opt.planning.problem.symbolic_expressions import list_table_calls


@dataclass(frozen=True, eq=False)
class Extremum:
    """Kink as extremum of its pieces; sense 1: maximum, to be minimised; -1: minimum, to be maximised."""

    node: Any
    sense: int
    pieces: Pieces


def find_cost_kinks(problem: ProblemData, phase: Phase, domain: SymbolRanges) -> dict[str, list[Extremum]]:
    """Return the convex kinks of minimised integrands, and concave ones of maximised, except tables, by integral."""
    _, x, u, _ = phase.model.symbolic_arguments()
    tables = list_table_calls(problem, problem.phases[phase.name])
    ignored, by_integral = frozenset[int]().union(*(use.subexpression_hashes for use in tables)), {}
    senses = find_minimised_or_maximised_integrals(problem, phase)
    for name, (_, integrand) in phase.integrands.items():
        nodes = find_outermost_kinks(integrand, ignored, domain) if senses[name] else []
        nodes = [node for node in nodes if ca.depends_on(node, ca.vertcat(x, u))]
        if nodes:
            by_integral[name] = list(find_convex_kinks(integrand, nodes, senses[name], domain))
    return {name: kinks for name, kinks in by_integral.items() if kinks}


def find_convex_kinks(scalar: Any, nodes: list[Any], sense: int, domain: SymbolRanges) -> Iterator[Extremum]:
    """Yield the kinks of a scalar that are convex if it is minimised (sense 1) or maximised (-1)."""
    for node, direction in zip(nodes, domain.compute_monotonicity_signs(scalar, nodes), strict=True):
        kink_sense = sense * direction
        pieces = find_max_or_min_arguments(node, kink_sense, domain) if kink_sense else None
        kink = Extremum(node, kink_sense, pieces or [])
        if len(kink.pieces) > 1 and not _is_kink_smoothed(scalar, kink):
            yield kink


def _is_kink_smoothed(expression: Any, kink: Extremum) -> bool:
    """Return whether an expression has a zero or infinite slope where two pieces of a kink meet: ``fmax(a, 0)**2``."""
    z = ca.SX.sym("z")
    of_z = replace_subexpressions_by_hash(expression, {kink.node.element_hash(): z})
    slope = ca.densify(ca.jacobian(of_z, z))
    for first, second in combinations(kink.pieces, 2):
        symbol = next((s for s in ca.symvar(second - first) if is_affine(second - first, s)), None)
        if symbol is None:
            return False
        gap = second - first
        column = ca.vertcat(ca.substitute(slope, z, first), first, *kink.pieces)
        at_corner = ca.substitute(column, symbol, solve_affine_equation(gap, symbol))
        slopes, first_values, *piece_values = sample_expression_randomly(at_corner)
        largest = np.all(kink.sense * (first_values - np.array(piece_values)) >= -EQUAL, axis=0)
        if np.any(largest & ~np.isfinite(slopes)):
            return True
        if np.any(largest & (np.abs(slopes) > EQUAL)):
            return False
    return True


def find_minimised_or_maximised_integrals(problem: ProblemData, phase: Phase) -> dict[str, int]:
    """Return 1 for integrals that are only minimised, -1 for those only maximised, else 0, by name."""
    domain = SymbolRanges.collect_boundary_variable_ranges(problem)
    functions = ca.vertcat(problem.sense * problem.cost, problem.constraint_expression())
    ends = problem.substitute_parameters(phase, functions)
    box = problem.get_boundary_constraint_bounds()
    lower, upper = np.isfinite(np.append(-np.inf, box.lower)), np.isfinite(np.append(0.0, box.upper))
    senses = {}
    for name, (symbol, _) in phase.integrands.items():
        slopes = ca.jacobian(ends, symbol)
        rows = [i for i in range(ends.numel()) if not slopes[i].is_zero()]
        row_senses = {domain.find_expression_sign(slopes[i]) * (int(upper[i]) - int(lower[i])) for i in rows}
        senses[name] = row_senses.pop() if len(row_senses) == 1 else 0
    return senses


KINKED = (ca.OP_FABS, ca.OP_FMAX, ca.OP_FMIN, ca.OP_IF_ELSE_ZERO)
"""Operations that have kinks."""

KINK_MAX_PIECES = 16
"""Largest number of pieces of a kink, as of a sum of four absolute values."""

Pieces: TypeAlias = list[Any]


def is_free_of_kinks(expression: Any) -> bool:
    """Return whether an expression contains no operation of `KINKED`."""
    return not any(node.op() in KINKED for node in iterate_subexpressions(expression))


def find_outermost_kinks(expression: Any, ignored: frozenset[int], domain: SymbolRanges) -> list[Any]:
    """Return the outermost kinks of a scalar expression, except nodes with these hashes."""
    kinks: dict[int, Any] = {}
    visited: set[int] = set()
    unvisited = [expression]
    while unvisited:
        node = unvisited.pop()
        key = node.element_hash()
        if key in visited or key in ignored:
            continue
        visited.add(key)
        if _read_max_or_min_arguments(node, domain) is not None:
            kinks[key] = node
        else:
            unvisited += [node.dep(i) for i in range(node.n_dep())]
    return list(kinks.values())


def find_max_or_min_arguments(expression: Any, sense: int, domain: SymbolRanges) -> Pieces | None:
    """Return smooth expressions whose maximum (sense 1) or minimum (-1) is a scalar; None if there are none."""
    unsplit, smooth = [expression], dict[int, Any]()
    while unsplit:
        node, *unsplit = unsplit
        if is_free_of_kinks(node):
            smooth[node.element_hash()] = node
            continue
        alternatives = _split_kinks_into_smooth_expressions(node, sense, domain)
        if alternatives is None or len(alternatives) + len(unsplit) + len(smooth) > KINK_MAX_PIECES:
            return None
        unsplit = alternatives + unsplit
    return list(smooth.values())


def _split_kinks_into_smooth_expressions(expression: Any, sense: int, domain: SymbolRanges) -> Pieces | None:
    """Return the expressions with one argument each in place of their outermost kinks; None if not their extremum.

    A scalar that is affine and monotone in extrema is the extremum of its values at the arguments.
    """
    nodes = find_outermost_kinks(expression, frozenset(), domain)
    hashes, z = [node.element_hash() for node in nodes], ca.SX.sym("z", len(nodes))
    if not nodes:
        return None
    of_z = replace_subexpressions_by_hash(expression, dict(zip(hashes, ca.vertsplit(z), strict=True)))
    if not is_affine(of_z, z):
        return None
    extrema = [_read_max_or_min_arguments(node, domain) for node in nodes]
    signs = [domain.find_expression_sign(slope) for slope in ca.horzsplit(ca.jacobian(of_z, z))]
    if any(e is None or e[0] * sign != sense for e, sign in zip(extrema, signs, strict=True)):
        return None
    choices = product(*(e[1] for e in extrema if e is not None))
    alternatives = (dict(zip(hashes, chosen, strict=True)) for chosen in choices)
    return [replace_subexpressions_by_hash(expression, substitutes) for substitutes in alternatives]


def _read_max_or_min_arguments(node: Any, domain: SymbolRanges) -> tuple[int, Pieces] | None:
    """Return 1 for a maximum, -1 for a minimum, with its arguments; None for other nodes."""
    operation = node.op()
    if operation == ca.OP_FABS:
        inner = node.dep(0)
        return 1, [inner] if domain.find_expression_sign(inner) > 0 else [inner, -inner]
    if operation == ca.OP_FMAX:
        return 1, [node.dep(0), node.dep(1)]
    if operation == ca.OP_FMIN:
        return -1, [node.dep(0), node.dep(1)]
    return _find_if_else_arguments(node, domain) if operation == ca.OP_ADD else None


def _find_if_else_arguments(node: Any, domain: SymbolRanges) -> tuple[int, Pieces] | None:
    """Return the pieces of a continuous ``if_else(a < b, ...)`` with a kink at a = b."""
    first, second = node.dep(0), node.dep(1)
    if first.op() != ca.OP_IF_ELSE_ZERO or second.op() != ca.OP_IF_ELSE_ZERO:
        return None
    condition, negated = first.dep(0), second.dep(0)
    is_negation = negated.op() == ca.OP_NOT and negated.dep(0).element_hash() == condition.element_hash()
    if not is_negation or condition.op() not in (ca.OP_LT, ca.OP_LE):
        return None
    if_true, if_false = first.dep(1), second.dep(1)
    gap, rise = condition.dep(1) - condition.dep(0), if_true - if_false
    for symbol in ca.symvar(gap):
        if not is_affine(ca.vertcat(gap, rise), symbol):
            continue
        gap_slope, rise_slope = ca.jacobian(gap, symbol), ca.jacobian(rise, symbol)
        rises = sample_expression_randomly(ca.substitute(rise, symbol, solve_affine_equation(gap, symbol)))
        sense = domain.find_expression_sign(gap_slope) * domain.find_expression_sign(rise_slope)
        if sense != 0 and np.all(np.abs(rises) < EQUAL):
            return sense, [if_true, if_false]
    return None


def solve_affine_equation(gap: Any, symbol: Any) -> Any:
    """Return the zero of a scalar that is affine in a symbol."""
    return -ca.substitute(gap, symbol, 0.0) / ca.jacobian(gap, symbol)


def has_kinks_in_endpoint_functions(problem: ProblemData) -> bool:
    """Return whether cost or boundary constraints contain a kink."""
    ends = ca.vertcat(0.0 if problem.cost is None else problem.cost, problem.constraint_expression())
    codes = problem.memoize(("operations", "ends"), lambda: collect_casadi_operation_codes(ends))
    return bool({*KINKED} & codes)


@dataclass(frozen=True, eq=False)
class EndpointEpigraph:
    """Cost and boundary constraints with kinks replaced by free parameters with a lower bound."""

    cost: Any
    constraints: dict[str, Constraint]
    parameters: dict[str, tuple[Symbol, float]]
    texts: tuple[str, ...]

    @classmethod
    def from_problem(cls, problem: ProblemData, domain: SymbolRanges) -> EndpointEpigraph:
        changed = smooth_constraints(problem.constraints, domain)
        constraints, substitutes = {**problem.constraints, **changed}, {}
        parameters: dict[str, tuple[Symbol, float]] = {}
        used_names = {*problem.parameters.names, *constraints}
        used_names |= {name for phase in problem.phases.values() for name in phase.model.parameters.names}
        nodes = find_outermost_kinks(problem.cost, frozenset(), domain)
        for kink in find_convex_kinks(problem.cost, nodes, int(problem.sense), domain):
            name = f"epigraph_of_cost_{len(parameters) + 1}"
            while name in used_names:
                name += "_"
            symbol = Symbol(Variable(name, 1, ""))
            constraints[name], lower_bound = build_epigraph_rows(symbol, kink)
            parameters[name] = (symbol, lower_bound)
            substitutes[kink.node.element_hash()] = kink.sense * symbol
        cause = "a kink of the cost is replaced by parameter"
        texts = [f"{cause} {name}, bounded by its pieces" for name in parameters]
        texts += [f"'{name}' is replaced by {c.size} smooth limits" for name, c in changed.items()]
        cost = replace_subexpressions_by_hash(problem.cost, substitutes)
        return cls(cost, constraints, parameters, tuple(texts))

    @property
    def cache_key(self) -> tuple[Any, ...]:
        """Key that is equal for equal forms."""
        return tuple((name, c.size) for name, c in self.constraints.items())

    def reformulate_endpoint_functions(self, problem: ProblemData) -> None:
        for symbol, lower_bound in self.parameters.values():
            box = Interval(np.array([lower_bound]), np.full(1, np.inf))
            problem.add_parameter(symbol, box, np.array([max(lower_bound, 0.0)]))
        problem.cost, problem.constraints = self.cost, dict(self.constraints)
        next(iter(problem.phases.values())).describe_reformulation(*self.texts)


@dataclass(frozen=True, eq=False)
class KinkedTerms:
    """Kinks of integrals by name, and path constraints with kinked rows split into smooth ones."""

    costs: dict[str, list[Extremum]]
    limits: dict[str, Constraint]

    @classmethod
    def from_phase(cls, problem: ProblemData, phase: Phase, domain: SymbolRanges) -> KinkedTerms:
        return cls(find_cost_kinks(problem, phase, domain), smooth_constraints(phase.paths, domain))

    @property
    def cache_key(self) -> tuple[Any, ...]:
        """Key that is equal for equal forms."""
        costs = ((name, *(k.node.element_hash() for k in kinks)) for name, kinks in self.costs.items())
        return (*costs, *((name, c.size) for name, c in self.limits.items()))

    def reformulate_phase(self, problem: ProblemData, phase: Phase, key: tuple[Any, ...]) -> None:
        """Replace the kinks of a phase by controls above their pieces."""
        form = problem.memoize(("epigraph", *key), lambda: Epigraph.from_phase(phase, self))
        form.reformulate_phase(problem, phase)


def smooth_constraints(constraints: Mapping[str, Constraint], domain: SymbolRanges) -> dict[str, Constraint]:
    """Return the constraints of which rows are extrema, with smooth rows in their place."""
    split = {name: _smooth_constraint(c, domain) for name, c in constraints.items()}
    return {name: c for name, c in split.items() if c is not None}


def _smooth_constraint(constraint: Constraint, domain: SymbolRanges) -> Constraint | None:
    """Return a constraint with smooth rows in place of rows that are their extremum; None if there are none."""
    rows: list[tuple[Any, float, float]] = []
    changed = False
    for row, lower, upper in zip(
        ca.vertsplit(constraint.expression), constraint.interval.lower, constraint.interval.upper, strict=True
    ):
        sense = int(np.isfinite(upper)) - int(np.isfinite(lower))  # 0 with limits on both sides
        is_kept = not sense or is_free_of_kinks(row)
        pieces = None if is_kept else find_max_or_min_arguments(row, sense, domain)
        changed |= pieces is not None
        for e in pieces or [row]:
            if pieces is None or not (e.is_constant() and lower <= float(e) <= upper):
                rows.append((e, lower, upper))
    if not changed or not rows:
        return None
    expressions, *limits = zip(*rows, strict=True)
    return Constraint(constraint.name, ca.vertcat(*expressions), Interval(*map(np.array, limits)))


def build_epigraph_rows(symbol: Symbol, kink: Extremum) -> tuple[Constraint, float]:
    """Return the constraint that a symbol is above the pieces of a kink, and the largest constant piece."""
    pieces = [kink.sense * e for e in kink.pieces]
    rows = [symbol - e for e in pieces if not e.is_constant()]
    constants = [float(e) for e in pieces if e.is_constant()]
    limits = Interval(np.zeros(len(rows)), np.full(len(rows), np.inf))
    return Constraint(symbol.variable.name, ca.vertcat(*rows), limits), max(constants, default=-np.inf)


@dataclass(frozen=True, eq=False)
class Epigraph(ReformulatedPhase):
    """Form of a phase with controls in place of kinks, and the lower bounds of these controls by name."""

    kinks: dict[str, Extremum]
    lower_bounds: dict[str, float]

    @classmethod
    def from_phase(cls, phase: Phase, kinked: KinkedTerms) -> Epigraph:
        model = phase.model
        symbols: dict[int, Symbol] = {}
        kinks, lower_bounds, texts = {}, {}, []
        integrands, paths = dict(phase.integrands), {**phase.paths, **kinked.limits}
        for name, cost_kinks in kinked.costs.items():
            for kink in cost_kinks:
                key = kink.node.element_hash()
                if key not in symbols:
                    label = f"epigraph_{len(symbols) + 1}".removesuffix("_1")
                    label = choose_unused_variable_name(model, label)
                    s = symbols[key] = Symbol(Variable(label, 1, ""))
                    kinks[label] = kink
                    paths[label], lower_bounds[label] = build_epigraph_rows(s, kink)
                    texts.append(f"a kink of integral '{name}' is replaced by {label}, bounded by its pieces")
            value = {k.node.element_hash(): k.sense * symbols[k.node.element_hash()] for k in cost_kinks}
            symbol, integrand = integrands[name]
            integrands[name] = (symbol, replace_subexpressions_by_hash(integrand, value))
        texts += [f"'{n}' is replaced by {c.size} smooth limits" for n, c in kinked.limits.items()]
        empty = ca.SX(0, 1)
        values = [ca.fmax(kink.sense * kink.node, lower_bounds[label]) for label, kink in kinks.items()]
        controls = [*(model.symbol(name) for name in model.controls.names), *symbols.values()]
        return cls(
            model.express_in_other_controls(controls, [], lambda expression: expression),
            paths,
            integrands,
            ControlMap(model, empty, empty, ca.vertcat(model.symbols("control"), *values), tuple(texts)),
            kinks,
            lower_bounds,
        )

    def reformulate_phase(self, problem: ProblemData, phase: Phase) -> None:
        original, numbers = phase.clone(), phase.numbers
        lower = np.array([self.lower_bounds[name] for name in self.kinks])
        values = dict(numbers.guess.values)
        for name, kink in self.kinks.items():
            values[name] = build_guess_of_expression(problem, original, kink.sense * kink.node)
        controls = stack_intervals([numbers.controls, Interval(lower, np.full(lower.size, np.inf))])
        guess = PhaseGuess(numbers.guess.time, values)
        self.apply_to_phase(phase, replace(numbers, controls=controls, guess=guess))
