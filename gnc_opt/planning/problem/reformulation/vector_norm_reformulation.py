r"""Vectors as magnitude and direction: explicit norms, unit vectors, and limits without square roots.

:math:`\sqrt{S} \le c` is equivalent to :math:`S / (2 c) + c / 2 \le c`. Both sides have equal values and gradients at
the limit, and therefore equal multipliers; the root has no derivative at S = 0.

The direction n of a thrust :math:`d n` is free along coasts, d = 0. If all functions are affine in n and d, and n
occurs only times d, n is solved for with :math:`|n| \le 1`, as in ``Model.vector_control``, and reported with
length 1: along coasts against the primer, where it minimises H.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from gnc_opt.model.casadi_expression_graph import (
    ROOTS,
    NormNodes,
    iterate_subexpressions,
    replace_subexpressions,
    replace_subexpressions_by_hash,
)
from gnc_opt.model.model_variables import Symbol, Variable
from gnc_opt.model.split_and_magnitude_direction_controls import (
    AssembledControl,
    ComposedControl,
    UnitVectorControl,
    VectorControl,
)
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.numerical_tolerances import EQUAL
from gnc_opt.planning.problem.bounds import (
    Interval,
    split_bounds_by_name,
    stack_intervals,
    stack_named_bounds,
)
from gnc_opt.planning.problem.constraints import Constraint
from gnc_opt.planning.problem.interval_arithmetic import is_affine, sample_expression_randomly
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.phase_bounds_and_guess import ControlMap, PhaseGuess
from gnc_opt.planning.problem.problem_definition import ProblemData
from gnc_opt.planning.problem.redundant_bounds import (
    compute_vector_length_from_equality,
    find_sum_of_squares_variables,
)
from gnc_opt.planning.problem.reformulation.reformulated_controls import (
    ReformulatedPhase,
    build_guess_of_expression,
    choose_unused_variable_name,
    collect_variable_names,
    substitute_controls_in_phase,
)
from gnc_opt.planning.problem.symbolic_expressions import stack_phase_expressions

Names: TypeAlias = tuple[str, ...]


def find_norm_substitution(phase: Phase) -> NormSubstitution | UnitVectorSubstitution | None:
    """Return the form for the largest vector whose norm is a root or limited by a control, else for a unit vector."""
    limited = (names for names, _, _ in _find_norm_limits(phase))
    names = max([*_find_vectors_in_norms(phase), *limited], key=len, default=None)
    if names is not None:
        return NormSubstitution.from_phase(phase, names)
    unit = next(_find_unit_vectors(phase), None)
    return None if unit is None else UnitVectorSubstitution.from_unit_vector(phase, *unit)


def index_control_symbols(phase: Phase) -> dict[int, int]:
    """Return the indices of the control components that are not parts of composed controls, by symbol hash."""
    model = phase.model
    parts = {part for composed in model.composed_controls.values() for part in composed.parts}
    part_rows = {i for part in parts for i in model.controls.indices(part)}
    symbols = ca.vertsplit(model.symbols("control"))
    return {s.element_hash(): i for i, s in enumerate(symbols) if i not in part_rows}


def _find_vectors_in_norms(phase: Phase) -> Iterator[Names]:
    """Yield vectors (whole controls) whose norm is a square root, not differentiable at zero."""
    indices, controls = index_control_symbols(phase), phase.model.controls
    for node in iterate_subexpressions(stack_phase_expressions(phase)):
        if node.op() in ROOTS:
            rows = {indices[h] for h in (s.element_hash() for s in ca.symvar(node)) if h in indices}
            names = tuple(name for name in controls.names if rows & {*controls.indices(name)})
            has_whole_controls = sum(controls[name].size for name in names) == len(rows)
            if has_whole_controls and len(rows) > 1:
                vector = ca.vertcat(*map(phase.model.symbol, names))
                if NormNodes.find_vector_norms(node, vector).degrees.get(node.element_hash()) == 1:
                    yield names


def _find_norm_limits(phase: Phase) -> Iterator[tuple[Names, str, str]]:
    """Yield vectors with the control >= 0 and the path constraint that limit their norm: ``T.T @ T <= d**2``."""
    layout, box = phase.model.controls, split_bounds_by_name(phase.numbers.controls, phase.model.controls)
    uncomposed = set(index_control_symbols(phase))
    for label, row, limits in _list_scalar_path_constraints(phase):
        hashes = {s.element_hash() for s in ca.symvar(row)}
        symbols = {name: phase.model.symbol(name) for name in layout.names}
        names = tuple(n for n, s in symbols.items() if hashes & {e.element_hash() for e in ca.vertsplit(s)})
        is_one_sided = np.sum(np.isfinite([limits.lower, limits.upper])) == 1
        for name in names if hashes <= uncomposed and is_one_sided else ():
            vector_names = tuple(other for other in names if other != name)
            if layout[name].size == 1 < sum(layout[n].size for n in vector_names) and box[name].lower[0] >= 0:
                vector, size = ca.vertcat(*(symbols[n] for n in vector_names)), ca.SX.sym("size")
                of_size = NormNodes.find_vector_norms(row, vector).replace_vector_norms(row, size, {})
                if _is_norm_upper_limit(of_size, size, symbols[name], limits):
                    yield vector_names, name, label


def _is_norm_upper_limit(expression: Any, size: Any, control: Any, limits: Interval) -> bool:
    """Return whether a row of a norm and a control states that the norm is at most the control."""
    for k in _TEST_NORMS:
        norm_limits = read_norm_limits(ca.substitute(expression, control, k), size, limits)
        if norm_limits is None or norm_limits[0] != 0 or abs(norm_limits[1] - k) > EQUAL * k:
            return False
    return True


def _list_scalar_path_constraints(phase: Phase) -> Iterator[tuple[str, Any, Interval]]:
    """Yield label, expression and limits of the rows of the user's path constraints."""
    lengths = {v.direction_norm_constraint_name for v in phase.vector_controls}
    for name, c in phase.paths.items():
        for i, label in enumerate(c.labels if name not in lengths else ()):
            yield label, c.expression[i], c.interval.select_components([i])


_TEST_NORMS = (0.7, 1.3, 2.1)


def read_norm_limits(expression: Any, size: Any, limits: Interval) -> tuple[float, float] | None:
    """Return the range of a norm equivalent to limits of a linear or quadratic expression of it, else None."""
    if any(s.element_hash() != size.element_hash() for s in ca.symvar(expression)):
        return None
    value = ca.Function("value", [size], [expression])
    constant = float(value(0.0))
    slope, double_slope = float(value(1.0)) - constant, float(value(2.0)) - constant
    power = next((p for p in (1, 2) if abs(double_slope - 2**p * slope) <= EQUAL * abs(double_slope)), None)
    if power is None or slope == 0:
        return None
    ends = np.sort(np.array([limits.lower[0] - constant, limits.upper[0] - constant]) / slope)
    lower, upper = np.maximum(ends, 0.0) ** (1 / power)
    return (float(lower), float(upper)) if ends[1] >= 0 else None


def remove_square_roots_from_norms(phase: Phase) -> dict[str, Constraint]:
    """Return the constraints of a phase with rows ``root <= c``, in the form without the root."""
    changed = {}
    for name, c in phase.paths.items():
        rows = ca.vertsplit(c.expression)
        smooth = [_remove_square_root(row, c.interval.select_components([i])) for i, row in enumerate(rows)]
        if any(row is not None for row in smooth):
            changed_rows = [a if b is None else b for a, b in zip(rows, smooth, strict=True)]
            changed[name] = replace(c, expression=ca.vertcat(*changed_rows))
    return changed


def _remove_square_root(row: Any, limits: Interval) -> Any | None:
    """Return a row with an upper limit on a function of one root in the form without the root; else None."""
    roots = (node for node in iterate_subexpressions(row) if node.op() in (ca.OP_SQRT, ca.OP_HYPOT))
    root = next(roots, None)
    if root is None:
        return None
    root_hash, size = root.element_hash(), ca.SX.sym("size")
    of_size = replace_subexpressions(row, lambda node: size if node.element_hash() == root_hash else None)
    lower, upper = read_norm_limits(of_size, size, limits) or (np.inf, np.inf)
    symbols = ca.vertcat(*ca.symvar(root))
    at_origin = ca.Function("root", [symbols], [root])(np.zeros(symbols.numel()))
    if lower > 0 or not (0 < upper < np.inf) or float(at_origin) != 0:
        return None
    square = root.dep(0) if root.op() == ca.OP_SQRT else root.dep(0) ** 2 + root.dep(1) ** 2
    tangent = square / (2 * upper) + upper / 2
    return replace_subexpressions(row, lambda node: tangent if node.element_hash() == root_hash else None)


@dataclass(frozen=True, eq=False)
class NormSubstitution(ReformulatedPhase):
    """Form of a phase with a magnitude and a direction in place of a vector, the controls ``names``.

    ``product`` is the vector as their product, ``limits`` those of the norm from the removed constraints.
    ``unit_direction`` is True if a vector shorter than the magnitude could violate a limit, False if it cannot, None
    if `Phase.has_unit_direction` decides.
    """

    names: Names
    control: VectorControl
    product: Any
    limits: tuple[float, float]
    unit_direction: bool | None

    @classmethod
    def from_phase(cls, phase: Phase, names: Names) -> NormSubstitution:
        """Return the form of a phase in the norm of some controls."""
        model, vector = phase.model, ca.vertcat(*map(phase.model.symbol, names))
        outputs = [model.output_expression(name) for name in model.outputs.names]
        norms = NormNodes.find_vector_norms(ca.vertcat(stack_phase_expressions(phase), *outputs), vector)
        norm_limits = _NormLimits.collect_norm_limits(phase, names, norms)
        name, magnitude, direction = _create_vector_symbols(model, names)
        if norm_limits.control is not None:
            magnitude = model.symbol(norm_limits.control)
        product = magnitude * direction
        pairs = zip(ca.vertsplit(vector), ca.vertsplit(product), strict=True)
        substitutes = {symbol.element_hash(): value for symbol, value in pairs}

        def substitute_norm(expression: Any) -> Any:
            return norms.replace_vector_norms(expression, magnitude, substitutes)

        parts = (magnitude.variable.name, direction.variable.name)
        control = VectorControl(Variable(name, vector.numel(), model.controls[names[0]].unit), parts)
        composed, first = list[tuple[ComposedControl, Any]]([(control, product)]), 0
        for v in (model.controls[name] for name in names if len(names) > 1):
            rows = tuple(range(first, first + v.size))
            composed.append((AssembledControl(v, parts, rows), product[list(rows)]))
            first += v.size
        remaining = norm_limits.other_paths
        paths, unit_direction = _reformulate_path_constraints(remaining, substitute_norm, magnitude)
        lengths = [v.direction_norm_constraint_name for v in phase.vector_controls]
        controls, values = list[Symbol](), list[Any]()
        norm = ca.norm_2(vector) if norm_limits.control is None else magnitude
        for v in model.controls.variables:
            if v.name == names[0]:
                controls += [magnitude, direction]
                values += [norm, vector / norm]
            elif v.name not in (*names, norm_limits.control):
                controls.append(model.symbol(v.name))
                values.append(model.symbol(v.name))
        vector_text = name if len(names) == 1 else f"[{', '.join(names)}]"
        text = f"{vector_text} is replaced by {' * '.join(parts)}"
        if norm_limits.labels:
            labels = " and ".join(map(repr, norm_limits.labels))
            text += f", whose magnitude {labels} limit{'s' * (len(norm_limits.labels) == 1)}"
        return cls(
            model.express_in_other_controls(controls, composed, substitute_norm),
            paths | {label: phase.paths[label] for label in lengths},
            {name: (symbol, substitute_norm(e)) for name, (symbol, e) in phase.integrands.items()},
            ControlMap(model, vector, product, ca.vertcat(*values), (text,)),
            names,
            control,
            product,
            norm_limits.range,
            unit_direction or None if norm_limits.control is None else False,
        )

    def reformulate_phase(self, problem: ProblemData, phase: Phase) -> tuple[str, ...]:
        """Apply the form to a phase, with the numbers of that phase; return the names of the added constraints."""
        original, numbers, magnitude = phase.clone(), phase.numbers, self.control.magnitude
        rows = self._constrain_vector_components(original)
        boxes = split_bounds_by_name(numbers.controls, original.model.controls)
        boxes.setdefault(magnitude, Interval(np.array([self.limits[0]]), np.array([self.limits[1]])))
        scales = {name: value for name, value in numbers.scales.items() if name not in self.names}
        vector_scales = [np.max(numbers.scales[name]) for name in self.names if name in numbers.scales]
        if vector_scales and magnitude not in original.model.controls:
            scales[magnitude] = np.array([max(vector_scales)])
        guess = numbers.guess
        if len(self.names) > 1 and guess.values.keys() & set(self.names):
            values = {name: value for name, value in guess.values.items() if name not in self.names}
            vector = ca.vertcat(*map(original.model.symbol, self.names))
            values[self.control.name] = build_guess_of_expression(problem, original, vector)
            guess = PhaseGuess(guess.time, values)
        controls = stack_named_bounds(boxes, self.model.controls)
        self.apply_to_phase(phase, replace(numbers, controls=controls, scales=scales, guess=guess))
        phase.paths |= rows
        phase.record_vector_control(self.control, on_sphere=self.unit_direction)
        return tuple(rows)

    def _constrain_vector_components(self, original: Phase) -> dict[str, Constraint]:
        """Return the bounds of components that the norm does not imply, as constraints of the product."""
        boxes = split_bounds_by_name(original.numbers.controls, original.model.controls)
        box = stack_intervals(boxes[name] for name in self.names)
        labels = [label for name in self.names for label in original.model.controls[name].labels]
        magnitude, rows = self.model.symbol(self.control.magnitude), {}
        bounds = boxes.get(self.control.magnitude)
        largest_norm = self.limits[1] if bounds is None else bounds.upper[0]
        lower = np.where(box.lower <= -largest_norm, -np.inf, box.lower)
        upper = np.where(box.upper >= largest_norm, np.inf, box.upper)
        for i in np.flatnonzero(np.isfinite(lower) | np.isfinite(upper)):
            name, limits = f"bounds of {labels[i]}", Interval(lower[[i]], upper[[i]])
            row = _divide_cone_constraint_by_magnitude(self.product[int(i)], limits, magnitude)
            rows[name] = Constraint(name, row, limits)
        return rows


def _create_vector_symbols(model: Model, names: Names) -> tuple[str, Symbol, Symbol]:
    """Return the name of a vector, the name or common prefix of its controls, the magnitude and the direction."""
    variables = [model.controls[name] for name in names]
    common_letters = takewhile(lambda letters: len(set(letters)) == 1, zip(*names, strict=False))
    common = "".join(letters[0] for letters in common_letters).rstrip("_")
    is_usable = len(names) == 1 or (common.isidentifier() and common not in collect_variable_names(model))
    name = common if is_usable else "_".join(names)
    nominals = [max(v.nominal) for v in variables if v.nominal is not None]
    nominal, size = (max(nominals),) if nominals else None, sum(v.size for v in variables)
    labels = [choose_unused_variable_name(model, f"{name}_{suffix}") for suffix in ("magnitude", "direction")]
    magnitude = Variable(labels[0], 1, variables[0].unit, nominal)
    return name, Symbol(magnitude), Symbol(Variable(labels[1], size, "", (1.0,) * size))


@dataclass(frozen=True, eq=False)
class _NormLimits:
    """Limits of a norm from the path constraints ``labels`` of a phase, and the remaining constraints.

    ``control`` is the magnitude: a control that limits the norm from above and occurs nowhere else; None without one.
    """

    other_paths: list[Constraint]
    range: tuple[float, float]
    labels: list[str]
    control: str | None

    @classmethod
    def collect_norm_limits(cls, phase: Phase, names: Names, norms: NormNodes) -> _NormLimits:
        size, lower, upper = ca.SX.sym("size"), 0.0, np.inf
        remaining, norm_labels = list[Constraint](), list[str]()
        for label, row, limits in _list_scalar_path_constraints(phase):
            norm_limits = read_norm_limits(norms.replace_vector_norms(row, size, {}), size, limits)
            if norm_limits is None:
                remaining.append(Constraint(label, row, limits))
            else:
                lower, upper = max(lower, norm_limits[0]), min(upper, norm_limits[1])
                norm_labels.append(label)
        limiting = [(control, label) for n, control, label in _find_norm_limits(phase) if n == names]
        if len(limiting) == 1 and not norm_labels:
            ((control, label),) = limiting
            other_paths = [c for c in remaining if c.name != label]
            rows = ca.vertcat(*(c.expression for c in other_paths))
            other_functions = ca.vertcat(phase.model.state_derivative(), phase.integrand_expression(), rows)
            if not ca.depends_on(norms.replace_vector_norms(other_functions, size, {}), size):
                return cls(other_paths, (0.0, np.inf), [label], control)
        return cls(remaining, (lower, upper), norm_labels, None)


def _reformulate_path_constraints(
    rows: list[Constraint], express: Callable[[Any], Any], magnitude: Symbol
) -> tuple[dict[str, Constraint], bool]:
    """Return constraints of magnitude and direction, and whether one requires the norm to equal the magnitude."""
    paths: dict[str, Constraint] = {}
    unit_direction = False
    for row in rows:
        expression = _divide_cone_constraint_by_magnitude(express(row.expression), row.interval, magnitude)
        if ca.depends_on(expression, magnitude):
            unit_direction |= not _is_constraint_met_by_shorter_vectors(expression, magnitude, row.interval)
            expression = _linearise_squared_magnitude_limit(expression, row.interval, magnitude)
        paths[row.name] = replace(row, expression=expression)
    return paths, unit_direction


def _divide_cone_constraint_by_magnitude(expression: Any, limits: Interval, magnitude: Any) -> Any:
    """Return a row with zero limits (a cone), divided by the magnitude if that is a factor."""
    ends = np.array([limits.lower[0], limits.upper[0]])
    is_cone = np.all((ends == 0) | ~np.isfinite(ends)) and is_affine(expression, magnitude)
    is_cone = is_cone and not np.any(sample_expression_randomly(ca.substitute(expression, magnitude, 0.0)))
    return ca.substitute(expression, magnitude, 1.0) if is_cone else expression


def _linearise_squared_magnitude_limit(expression: Any, limits: Interval, magnitude: Any) -> Any:
    r"""Return a limit proportional to the square of the magnitude as one proportional to the magnitude.

    :math:`r^2 \le c^2` becomes :math:`2 c r - c^2 \le c^2`, with the same gradient at the limit and the same
    multiplier. The square has zero slope at a zero vector, whereas H is linear in the magnitude.
    """
    ends = [end for end in (limits.lower[0], limits.upper[0]) if np.isfinite(end)]
    at_one = ca.substitute(expression, magnitude, 1.0)
    residual, total = sample_expression_randomly(ca.vertcat(expression - magnitude**2 * at_one, expression))
    if len(ends) != 1 or not ends[0] > 0 or not np.all(np.abs(residual) <= EQUAL * np.abs(total)):
        return expression
    largest_norm = float(np.sqrt(ends[0]))
    root = (at_one**0.25) ** 2  # CasADi converts the root of a square to fabs
    return 2 * largest_norm * magnitude * root - largest_norm**2


def _is_constraint_met_by_shorter_vectors(expression: Any, size: Any, limits: Interval) -> bool:
    """Return whether every shorter vector also satisfies the limits of a scalar expression, tested numerically."""
    symbols = [s for s in ca.symvar(expression) if s.element_hash() != size.element_hash()]
    function = ca.Function("row", [size, ca.vertcat(*symbols) if symbols else ca.SX(0, 1)], [expression])
    other_values = np.random.default_rng(20).uniform(0.5, 1.5, (len(symbols), 5))
    values = np.stack([function(np.full((1, 5), k), other_values).full()[0] for k in _TEST_NORMS])
    is_rising, is_falling = np.all(np.diff(values, axis=0) >= 0), np.all(np.diff(values, axis=0) <= 0)
    return bool((is_rising and limits.lower[0] == -np.inf) or (is_falling and limits.upper[0] == np.inf))


@dataclass(frozen=True, eq=False)
class UnitVectorSubstitution(ReformulatedPhase):
    """Form of a phase with the direction of a vector control in place of a unit vector, the first of ``names``."""

    names: tuple[str, str]
    control: VectorControl

    @classmethod
    def from_unit_vector(cls, phase: Phase, name: str, magnitude: str, label: str) -> UnitVectorSubstitution:
        """Return the form of a phase for a unit vector, its magnitude, and the path constraint on its length."""
        model, vector = phase.model, ca.SX(phase.model.symbol(name))
        size, v = model.symbol(magnitude), model.controls[name]
        label_of_direction = choose_unused_variable_name(model, f"{name}_direction")
        direction = Symbol(Variable(label_of_direction, v.size, "", (1.0,) * v.size))
        parts = (magnitude, label_of_direction)
        label_of_vector = choose_unused_variable_name(model, f"{magnitude}_{name}")
        control = VectorControl(Variable(label_of_vector, v.size, size.variable.unit), parts)
        unit = direction / ca.norm_2(direction)
        pairs = zip(ca.vertsplit(vector), ca.vertsplit(direction), strict=True)
        substitutes = {symbol.element_hash(): value for symbol, value in pairs}

        def substitute_unit_vector(expression: Any) -> Any:
            return replace_subexpressions_by_hash(expression, substitutes)

        controls = [direction if n == name else model.symbol(n) for n in model.controls.names]
        composed = [(control, size * direction), (UnitVectorControl(v, parts[1:]), unit)]
        text = f"{magnitude} * {name} is replaced by {' * '.join(parts)}"
        form = ControlMap(model, vector, unit, model.symbols("control"), (text,))
        substitution = controls, composed, substitute_unit_vector
        functions = substitute_controls_in_phase(phase, *substitution, label)
        return cls(*functions, form, (name, magnitude), control)

    def reformulate_phase(self, problem: ProblemData, phase: Phase) -> tuple[str, ...]:
        """Apply the form to a phase with its own numbers, without the bounds implied by the length."""
        numbers, rows = phase.numbers, phase.model.controls.slice(self.names[0])
        lower, upper = numbers.controls.lower.copy(), numbers.controls.upper.copy()
        lower[rows], upper[rows] = -np.inf, np.inf
        scales = {name: scale for name, scale in numbers.scales.items() if name != self.names[0]}
        self.apply_to_phase(phase, replace(numbers, controls=Interval(lower, upper), scales=scales))
        phase.record_vector_control(self.control, on_sphere=False)
        return ()


def _find_unit_vectors(phase: Phase) -> Iterator[tuple[str, str, str]]:
    """Yield controls of length 1 without other bounds, with magnitude and path constraint on the length."""
    layout, box = phase.model.controls, phase.numbers.controls
    uncomposed = set(index_control_symbols(phase).values())
    for label, constraint in phase.paths.items():
        if constraint.interval.upper.size > 1 or not all(constraint.interval.is_fixed):
            continue
        rows, constant = find_sum_of_squares_variables(phase, constraint.expression)
        length = compute_vector_length_from_equality(constraint.interval, constant)
        controls = [row - phase.model.states.size for row in rows]
        is_unit = abs(length - 1.0) <= EQUAL and len(controls) > 1 and uncomposed.issuperset(controls)
        for v in layout.variables if is_unit else ():
            is_whole_control = controls == [*layout.indices(v.name)]
            if is_whole_control and np.all(np.stack([-box.lower[controls], box.upper[controls]]) >= length):
                for magnitude in _find_magnitudes_of_unit_vector(phase, v.name, label):
                    yield v.name, magnitude, label


def _find_magnitudes_of_unit_vector(phase: Phase, name: str, label: str) -> Iterator[str]:
    """Yield the magnitudes of a unit vector: controls >= 0, its only factors, which also occur without it."""
    layout, vector = phase.model.controls, ca.SX(phase.model.symbol(name))
    other_paths = [c.expression for n, c in phase.paths.items() if n != label]
    functions = ca.vertcat(phase.model.state_derivative(), phase.integrand_expression(), *other_paths)
    at_zero = ca.substitute(functions, vector, ca.DM.zeros(vector.shape))
    slope = ca.vec(ca.jacobian(functions, vector))
    if ca.depends_on(slope, vector):
        return
    for row in index_control_symbols(phase).values():
        symbol = phase.model.symbols("control")[row]
        control = next(v for v in layout.variables if row in layout.indices(v.name))
        if control.size > 1 or phase.numbers.controls.lower[row] != 0 or not ca.depends_on(at_zero, symbol):
            continue
        affine = is_affine(ca.vertcat(at_zero, slope), symbol)
        if affine and not np.any(sample_expression_randomly(ca.substitute(slope, symbol, 0.0))):
            yield control.name
