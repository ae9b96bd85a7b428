r"""The form of a phase with vector controls in place of explicit norms of its controls, and limits without roots.

:math:`\sqrt{S} \le c` holds where :math:`S / (2 c) + c / 2 \le c` does. Both sides and their gradients are the same at
the limit, hence multipliers too; but the root has no derivative where S is zero.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import takewhile
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from gnc_opt.model.composed_controls import AssembledControl, ComposedControl, VectorControl
from gnc_opt.model.expressions import ROOTS, NormNodes, degree_in, nodes_of, rebuilt
from gnc_opt.model.model import Model
from gnc_opt.model.variables import Layout, Symbol, Variable
from gnc_opt.planning.problem.constraints import Constraint
from gnc_opt.planning.problem.expressions import along
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.phase_data import Restatement
from gnc_opt.planning.problem.reformulation.phase_form import PhaseForm, free_name, taken_names
from gnc_opt.tolerances import EQUAL

Places: TypeAlias = tuple[int, ...]


def norm_by_hand(leg: Phase) -> Places | None:
    """Return the components of the largest vector whose norm has to be restated; None if there is none."""
    return max([*_root_vectors(leg), *_squared_norms(leg)], key=len, default=None)


def stated_controls(leg: Phase) -> dict[int, int]:
    """Return the places of the control components that are no parts of composed ones, by the hash of their symbols."""
    model = leg.model
    parts = {part for composed in model.composed_controls.values() for part in composed.parts}
    taken = {i for part in parts for i in range(*model.controls.slice(part).indices(model.controls.size))}
    symbols = ca.vertsplit(model.symbols("control"))
    return {s.element_hash(): i for i, s in enumerate(symbols) if i not in taken}


def guessed_controls(leg: Phase) -> frozenset[str]:
    """Return the controls in the user's guess."""
    return frozenset(name for name in leg.numbers.guess.values if name in leg.model.controls)


def _root_vectors(leg: Phase) -> Iterator[Places]:
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
            if is_norm and not (_curves_in_all(leg, places) and _is_limited_only(leg, places)):
                yield places


def _curves_in_all(leg: Phase, places: Places) -> bool:
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
        node
        for node in nodes_of(elsewhere)
        if node.op() in ROOTS and own & {*map(_expression_hash, ca.symvar(node))}
    ]
    changed = without_roots(leg)
    rows = ca.vertcat(*(changed.get(name, c).expression for name, c in leg.paths.items()))
    left = [
        node
        for node in nodes_of(rows)
        if node.op() in ROOTS and own & {*map(_expression_hash, ca.symvar(node))}
    ]
    return not with_root and not left


def _expression_hash(symbol: Any) -> int:
    return int(symbol.element_hash())


def _squared_norms(leg: Phase) -> Iterator[Places]:
    """Yield vectors whose squared norm is limited at zero slope, or from below without a user's guess."""
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
        limits = box.row(row)
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


_SIZES = (0.7, 1.3, 2.1)


def limits_of(expression: Any, size: Any, limits: Interval) -> tuple[float, float] | None:
    """Return the range of a norm that limits of a linear or quadratic expression of it alone amount to, else None."""
    if any(s.element_hash() != size.element_hash() for s in ca.symvar(expression)):
        return None
    value = ca.Function("value", [size], [expression])
    rest = float(value(0.0))
    slope, double = float(value(1.0)) - rest, float(value(2.0)) - rest
    power = next((p for p in (1, 2) if abs(double - 2**p * slope) <= EQUAL * abs(double)), None)
    if power is None or slope == 0:
        return None
    ends = np.sort(np.array([limits.lower[0] - rest, limits.upper[0] - rest]) / slope)
    least, most = np.maximum(ends, 0.0) ** (1 / power)
    return (float(least), float(most)) if ends[1] >= 0 else None


def limiting_control(leg: Phase, expression: Any, size: Any, limits: Interval) -> int | None:
    """Return the place of the control >= 0 that a constraint makes the largest value of a norm, or equal to it."""
    model = leg.model
    controls = {s.element_hash(): i for i, s in enumerate(ca.vertsplit(model.symbols("control")))}
    others = [s for s in ca.symvar(expression) if s.element_hash() != size.element_hash()]
    if len(others) != 1 or others[0].element_hash() not in controls:
        return None
    place = controls[others[0].element_hash()]
    parts = {part for composed in model.composed_controls.values() for part in composed.parts}
    if model.controls.labels[place] not in model.controls or model.controls.labels[place] in parts:
        return None
    lower, upper = float(limits.lower[0]), float(limits.upper[0])
    value = ca.Function("value", [size, others[0]], [expression])
    beyond = float(value(2.0, 1.0))
    finite = [side for side in (lower, upper) if np.isfinite(side)]
    reach = max(abs(beyond), abs(finite[0])) if finite else 0.0
    at_limit = all(abs(float(value(k, k)) - side) <= EQUAL * reach for k in _SIZES for side in finite)
    least = leg.numbers.controls.lower[place]
    if not finite or not at_limit or beyond == finite[0]:
        return None
    broken = beyond > upper if np.isfinite(upper) else beyond < lower
    return place if least >= 0 and (lower == upper or (len(finite) == 1 and broken)) else None


def allows_shorter(expression: Any, size: Any, limits: Interval) -> bool:
    """Whether what a scalar expression is limited to is kept by any shorter vector, as numbers tell."""
    others = [s for s in ca.symvar(expression) if s.element_hash() != size.element_hash()]
    function = ca.Function("row", [size, ca.vertcat(*others) if others else ca.SX(0, 1)], [expression])
    rest = np.random.default_rng(20).uniform(0.5, 1.5, (len(others), 5))
    values = np.stack([function(np.full((1, 5), k), rest).full()[0] for k in _SIZES])
    grows, falls = np.all(np.diff(values, axis=0) >= 0), np.all(np.diff(values, axis=0) <= 0)
    return bool((grows and limits.lower[0] == -np.inf) or (falls and limits.upper[0] == np.inf))


def without_roots(leg: Phase) -> dict[str, Constraint]:
    """Return those constraints of a phase that have rows ``root <= c``, as they are without the root."""
    changed = {}
    for name, c in leg.paths.items():
        rows = [_without_root(row, c.interval.row(i)) for i, row in enumerate(ca.vertsplit(c.expression))]
        if any(row is not None for row in rows):
            kept = ca.vertsplit(c.expression)
            both = [old if new is None else new for new, old in zip(rows, kept, strict=True)]
            changed[name] = replace(c, expression=ca.vertcat(*both))
    return changed


def _without_root(row: Any, limits: Interval) -> Any | None:
    """Return a row that is a function of a root alone, with a limit from above, without it; else None."""
    root = next((node for node in nodes_of(row) if node.op() in (ca.OP_SQRT, ca.OP_HYPOT)), None)
    if root is None:
        return None
    place, size = root.element_hash(), ca.SX.sym("size")
    of_size = rebuilt(row, lambda node: size if node.element_hash() == place else None)
    found = limits_of(of_size, size, limits)
    if found is None or found[0] > 0 or not (0 < found[1] < np.inf) or not _root_vanishes(root):
        return None
    square = root.dep(0) if root.op() == ca.OP_SQRT else root.dep(0) ** 2 + root.dep(1) ** 2
    tangent = square / (2 * found[1]) + found[1] / 2
    return rebuilt(row, lambda node: tangent if node.element_hash() == place else None)


def _root_vanishes(root: Any) -> bool:
    """Whether a root is zero where everything is."""
    symbols = ca.vertcat(*ca.symvar(root))
    return float(ca.Function("root", [symbols], [root])(np.zeros(symbols.numel()))) == 0


@dataclass(frozen=True, eq=False)
class Row:
    """A row of a path constraint."""

    label: str
    expression: Any
    limits: Interval


@dataclass(frozen=True, eq=False)
class Vector:
    """The components of controls, by their places, that make up a vector of a model."""

    model: Model
    places: Places

    @cached_property
    def stated(self) -> tuple[Variable, ...]:
        """The controls that have components in it; they go."""
        layout = self.model.controls
        own = set(self.places)
        return tuple(v for v in layout.variables if own & set(_norm_range(layout, v.name)))

    @cached_property
    def rest(self) -> Places:
        """Places of components of those that are not in it."""
        every = [i for v in self.stated for i in _norm_range(self.model.controls, v.name)]
        return tuple(i for i in every if i not in self.places)

    @property
    def symbols(self) -> Any:
        """Of its components, (k, 1)."""
        return self.model.symbols("control")[list(self.places)]

    @property
    def name(self) -> str:
        """Of the vector: of the control, if it is one, else what their names begin with."""
        names = [v.name for v in self.stated]
        if len(names) == 1:
            return f"{names[0]}_vector" if self.rest else names[0]
        alike = takewhile(lambda letters: len(set(letters)) == 1, zip(*names, strict=False))
        common = "".join(letters[0] for letters in alike).rstrip("_")
        return common if common.isidentifier() and common not in taken_names(self.model) else "_".join(names)

    @property
    def nominal(self) -> tuple[float, ...] | None:
        """Typical norm."""
        known = [max(v.nominal) for v in self.stated if v.nominal is not None]
        return (max(known),) if known else None

    def new(self, what: str, size: int, nominal: tuple[float, ...] | None, unit: str = "") -> Symbol:
        """Return the symbol of a control ``name_what``, with a name that is not taken."""
        return Symbol(Variable(free_name(self.model, f"{self.name}_{what}"), size, unit, nominal))


@dataclass(frozen=True, eq=False)
class Form(PhaseForm):
    """A phase without one of its norms.

    Attributes
    ----------
    rest : Symbol or None
        Remaining components of the controls that were replaced.
    product : casadi.SX
        The vector as magnitude times direction.
    limits : tuple of float
        Of the norm, from the constraints that were removed.
    on_sphere : bool or None
        True if a shorter vector could violate a limit; False if the norm may be less than the magnitude; None if
        `Phase.on_sphere` decides.
    """

    vector: Vector
    control: VectorControl
    rest: Symbol | None
    product: Any
    limits: tuple[float, float]
    on_sphere: bool | None

    @classmethod
    def of(cls, leg: Phase, places: Places) -> Form:
        """Restate a phase in the norm of some of its control components."""
        old, vector = leg.model, Vector(leg.model, places)
        outputs = [old.output_expression(name) for name in old.outputs.names]
        norms = NormNodes.of(ca.vertcat(along(leg), *outputs), vector.symbols)
        limits = _Limits.of(leg, norms)
        unit = vector.stated[0].unit
        magnitude = limits.magnitude
        if magnitude is None:
            magnitude = vector.new("magnitude", 1, vector.nominal, unit)
        direction = vector.new("direction", len(places), (1.0,) * len(places))
        rest = vector.new("rest", len(vector.rest), None) if vector.rest else None
        product = magnitude * direction
        pieces = [*ca.vertsplit(product), *(ca.vertsplit(rest) if rest is not None else ())]
        controls = ca.vertsplit(old.symbols("control"))
        instead = {
            controls[i].element_hash(): e for i, e in zip((*places, *vector.rest), pieces, strict=True)
        }

        def express(expression: Any) -> Any:
            return norms.replaced(expression, magnitude, instead)

        parts = (magnitude.variable.name, direction.variable.name)
        control = VectorControl(Variable(vector.name, len(places), unit), parts)
        paths, on_sphere = _restated_paths(limits.kept, express, magnitude)
        paths |= {v.length: leg.paths[v.length] for v in leg.vectors}
        stated = ca.vertcat(*(old.symbol(v.name) for v in vector.stated))
        return cls(
            old.in_controls(
                _new_controls(vector, magnitude, direction, rest),
                [
                    (c, express(_composed_value(old, c, product)))
                    for c in _composed_vector(vector, control, rest)
                ],
                express,
            ),
            paths,
            {name: (symbol, express(e)) for name, (symbol, e) in leg.integrands.items()},
            Restatement(
                old,
                stated,
                express(stated),
                _vector_values(vector, magnitude, direction, rest),
                (f"{_shown_vector(vector)} is solved for as {' * '.join(parts)}{limits.text}",),
            ),
            vector,
            control,
            rest,
            product,
            limits.range,
            False if limits.most_only else on_sphere or None,
        )


# --- controls ---------------------------------------------------------------------------------------------


def _norm_range(layout: Layout, name: str) -> range:
    return range(*layout.slice(name).indices(layout.size))


def _shown_vector(vector: Vector) -> str:
    labels = [vector.model.controls.labels[i] for i in vector.places]
    whole = len(vector.stated) == 1 and not vector.rest
    return vector.name if whole else f"[{', '.join(labels)}]"


def _composed_vector(vector: Vector, control: VectorControl, rest: Symbol | None) -> list[ComposedControl]:
    """The vector, and the stated expression if it is not the vector itself."""
    if len(vector.stated) == 1 and rest is None:
        return [control]
    order = (*vector.places, *vector.rest)
    parts = (*control.parts, *(() if rest is None else (rest.variable.name,)))
    layout = vector.model.controls
    return [
        control,
        *(
            AssembledControl(v, parts, tuple(order.index(i) for i in _norm_range(layout, v.name)))
            for v in vector.stated
        ),
    ]


def _composed_value(old: Model, control: ComposedControl, product: Any) -> Any:
    """Return a composed control, in terms of the old controls if it was one of them."""
    return old.symbol(control.name) if control.name in old.controls else product


def _new_controls(vector: Vector, magnitude: Symbol, direction: Symbol, rest: Symbol | None) -> list[Symbol]:
    """All controls, the new ones where the first of the stated ones was, in the order of `Model.vector_control`."""
    old = vector.model
    new = [magnitude, direction, *(() if rest is None else (rest,))]
    controls: list[Symbol] = []
    for v in old.controls.variables:
        if v not in vector.stated:
            controls += [old.symbol(v.name)] if v is not magnitude.variable else []
        elif v is vector.stated[0]:
            controls += new
    return controls


def _vector_values(vector: Vector, magnitude: Symbol, direction: Symbol, rest: Symbol | None) -> Any:
    """Return the new controls in terms of the old ones; a direction of nothing is NaN."""
    old = vector.model
    kept = magnitude.variable.name in old.controls
    size = old.symbol(magnitude.variable.name) if kept else ca.norm_2(vector.symbols)
    values = {magnitude.variable.name: size, direction.variable.name: vector.symbols / size}
    if rest is not None:
        values[rest.variable.name] = old.symbols("control")[list(vector.rest)]
    new = [c.variable.name for c in _new_controls(vector, magnitude, direction, rest)]
    return ca.vertcat(*(values[name] if name in values else old.symbol(name) for name in new))


# --- constraints ------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Limits:
    """Limits of a norm by the path constraints of a phase: ``kept`` are the others.

    ``magnitude`` is a control that can take the norm's place; ``text`` names the removed constraints.
    """

    kept: list[Row]
    range: tuple[float, float]
    magnitude: Symbol | None
    most_only: bool
    text: str

    @classmethod
    def of(cls, leg: Phase, norms: NormNodes) -> _Limits:
        size = ca.SX.sym("size")
        least, most, gone, kept = 0.0, np.inf, [], []
        by: dict[str, tuple[int, Row]] = {}
        for row in _path_rows(leg):
            of_size = norms.replaced(row.expression, size, {})
            own = limits_of(of_size, size, row.limits)
            place = None if own else limiting_control(leg, of_size, size, row.limits)
            if own is not None:
                least, most = max(least, own[0]), min(most, own[1])
                gone.append(row.label)
            elif place is not None:
                by[row.label] = (place, row)
            else:
                kept.append(row)
        elsewhere = ca.vertcat(
            leg.model.derivative(), leg.integrand_expression(), *(r.expression for r in kept)
        )
        used = gone or ca.depends_on(norms.replaced(elsewhere, size, {}), size)
        if len(by) != 1 or used:
            return cls(
                kept + [row for _, row in by.values()], (least, most), None, False, _chosen_vector(gone)
            )
        ((label, (place, row)),) = by.items()
        symbol = leg.model.symbol(leg.model.controls.labels[place])
        return cls(kept, (0.0, np.inf), symbol, not row.limits.fixed[0], _chosen_vector([label]))


def _chosen_vector(labels: list[str]) -> str:
    return (
        f", whose magnitude {' and '.join(repr(n) for n in labels)} limit{'s' * (len(labels) == 1)}"
        if labels
        else ""
    )


def _path_rows(leg: Phase) -> Iterable[Row]:
    """Yield the rows of the user's path constraints."""
    lengths = {v.length for v in leg.vectors}
    for name, c in leg.paths.items():
        if name not in lengths:
            for i, label in enumerate(c.labels):
                box = c.interval.row(i)
                yield Row(label, c.expression[i], box)


def _restated_paths(
    rows: list[Row], express: Callable[[Any], Any], magnitude: Symbol
) -> tuple[dict[str, Constraint], bool]:
    """Return constraints of magnitude and direction, and whether one of them wants the norm to be the magnitude."""
    paths: dict[str, Constraint] = {}
    on_sphere = False
    for row in rows:
        expression = express(row.expression)
        if ca.depends_on(expression, magnitude) and _is_cone(expression, row.limits, magnitude):
            expression = ca.substitute(expression, magnitude, 1.0)
        elif ca.depends_on(expression, magnitude):
            on_sphere |= not allows_shorter(expression, magnitude, row.limits)
            expression = _without_square(expression, row.limits, magnitude)
        paths[row.label] = Constraint(row.label, expression, row.limits)
    return paths, on_sphere


def _without_square(expression: Any, limits: Interval, magnitude: Any) -> Any:
    r"""Return a limit proportional to the square of the magnitude as one proportional to the magnitude.

    :math:`r^2 \le c^2` is :math:`2 c r - c^2 \le c^2`, with the same gradient at the limit, hence the same multiplier;
    but the square has no slope where the vector is zero, and H is linear in the magnitude.
    """
    ends = [end for end in (limits.lower[0], limits.upper[0]) if np.isfinite(end)]
    if len(ends) != 1 or not ends[0] > 0 or degree_in(expression, magnitude) != 2:
        return expression
    most = float(np.sqrt(ends[0]))
    root = (
        ca.substitute(expression, magnitude, 1.0) ** 0.25
    ) ** 2  # CasADi makes fabs of the root of a square
    return 2 * most * magnitude * root - most**2


def _is_cone(expression: Any, limits: Interval, magnitude: Any) -> bool:
    """Whether the magnitude is a factor of the constrained expression."""
    ends = np.array([limits.lower[0], limits.upper[0]])
    return bool(np.all((ends == 0) | ~np.isfinite(ends))) and degree_in(expression, magnitude) in (1, 2)


def box_rows(form: Form, leg: Phase) -> dict[str, Constraint]:
    """Return the bounds of components of the vector that its norm does not imply, as constraints of the product."""
    box, labels = leg.numbers.controls, leg.model.controls.labels
    most = form.limits[1]
    if form.control.magnitude in leg.model.controls:
        most = float(box.upper[leg.model.controls.slice(form.control.magnitude)][0])
    magnitude = form.model.symbol(form.control.magnitude)
    rows = {}
    for i, value in zip(form.vector.places, ca.vertsplit(form.product), strict=True):
        lower, upper = box.lower[i], box.upper[i]
        lower, upper = (-np.inf if lower <= -most else lower), (np.inf if upper >= most else upper)
        if np.isfinite(lower) or np.isfinite(upper):
            limits = Interval(np.array([lower]), np.array([upper]))
            if _is_cone(value, limits, magnitude):
                value = ca.substitute(value, magnitude, 1.0)
            name = f"bounds of {labels[i]}"
            rows[name] = Constraint(name, value, limits)
    return rows
