r"""Split controls: differences of two parts, one on each side of the corner of a kink in an integral.

The maximum of :math:`e_0` and :math:`e_1` is :math:`e_0 + c \max(u - k, 0)` if their difference is affine in one
control u and vanishes at a constant k, with a factor c >= 0. At an optimum at most one part is nonzero. Each part is a
bounded control in which the cost is linear.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.model.casadi_expression_graph import replace_subexpressions_by_hash
from gnc_opt.model.model_variables import Symbol
from gnc_opt.model.split_and_magnitude_direction_controls import SplitControl
from gnc_opt.numerical_tolerances import EQUAL
from gnc_opt.planning.problem.bounds import (
    Interval,
    split_bounds_by_name,
    stack_named_bounds,
)
from gnc_opt.planning.problem.interval_arithmetic import SymbolRanges, is_affine, sample_expression_randomly
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.phase_bounds_and_guess import ControlMap
from gnc_opt.planning.problem.problem_definition import ProblemData
from gnc_opt.planning.problem.reformulation.epigraph import (
    Extremum,
    find_cost_kinks,
    solve_affine_equation,
)
from gnc_opt.planning.problem.reformulation.reformulated_controls import (
    ReformulatedPhase,
    choose_unused_variable_name,
    substitute_controls_in_phase,
)
from gnc_opt.planning.problem.reformulation.vector_norm_reformulation import index_control_symbols


@dataclass(frozen=True, eq=False)
class ControlKink:
    """Kink along a control component u: ``base + factor max(u - corner, 0)``, the factor signed as a cost."""

    node: Any
    base: Any
    factor: Any
    control: int
    corner: float

    @classmethod
    def find_control_kink_of_extremum(
        cls, kink: Extremum, controls: Mapping[int, Any], domain: SymbolRanges
    ) -> ControlKink | None:
        """Return the control kink; None if it has more than two pieces, or no constant corner along one control."""
        if len(kink.pieces) != 2:
            return None
        first, second = kink.pieces
        gap = second - first
        for control, u in controls.items():
            slope = ca.jacobian(gap, u)
            if slope.nnz() and is_affine(gap, u):
                corners = sample_expression_randomly(solve_affine_equation(gap, u))[0]
                sign = kink.sense * domain.find_expression_sign(slope)
                corner = float(np.median(corners))
                if sign and np.ptp(corners) <= EQUAL * max(1.0, abs(corner)):
                    base, factor = (first, slope) if sign > 0 else (second, -slope)
                    return cls(kink.node, base, factor, control, corner + 0.0)
        return None


@dataclass(frozen=True, eq=False)
class ControlKinks:
    """Kinks of integrals that control splitting removes, by integral; corners by the index of the control."""

    kinks: dict[str, list[ControlKink]]
    corners: dict[int, float]

    @classmethod
    def from_phase(cls, problem: ProblemData, phase: Phase, domain: SymbolRanges) -> ControlKinks:
        """Return the kinks along controls with exactly one corner in every component."""
        layout, symbols = phase.model.controls, ca.vertsplit(phase.model.symbols("control"))
        controls = {i: symbols[i] for i in index_control_symbols(phase).values()}
        by_integral = dict[str, list[ControlKink]]()
        for name, kinks in find_cost_kinks(problem, phase, domain).items():
            candidates = (ControlKink.find_control_kink_of_extremum(kink, controls, domain) for kink in kinks)
            by_integral[name] = [k for k in candidates if k is not None]
        all_kinks = [k for kinks in by_integral.values() for k in kinks]
        corners: dict[int, float] = {}
        for v in layout.variables:
            rows = layout.indices(v.name)
            corner_sets = [{k.corner for k in all_kinks if k.control == i} for i in rows]
            if all(len(values) == 1 for values in corner_sets):
                corners |= {i: values.pop() for i, values in zip(rows, corner_sets, strict=True)}
        removable = {name: [k for k in kinks if k.control in corners] for name, kinks in by_integral.items()}
        return cls({name: kinks for name, kinks in removable.items() if kinks}, corners)

    @property
    def cache_key(self) -> tuple[Any, ...]:
        """Key that is equal for equal forms."""
        return tuple((name, *(k.node.element_hash() for k in kinks)) for name, kinks in self.kinks.items())

    def reformulate_phase(self, problem: ProblemData, phase: Phase, key: tuple[Any, ...]) -> None:
        """Split the controls of a phase."""
        form = problem.memoize(("split", *key), lambda: SplitControls.split_controls_at_kinks(phase, self))
        form.reformulate_phase(phase)


@dataclass(frozen=True, eq=False)
class SplitControls(ReformulatedPhase):
    """Form of a phase with split controls."""

    controls: tuple[SplitControl, ...]

    @classmethod
    def split_controls_at_kinks(cls, phase: Phase, control_kinks: ControlKinks) -> SplitControls:
        """Return the form of a phase in the parts of the split controls."""
        old_model, layout = phase.model, phase.model.controls
        controls, values, splits = list[Symbol](), list[Any](), list[tuple[SplitControl, Any]]()
        values_by_hash, excess = dict[int, Any](), dict[int, Any]()
        for v in layout.variables:
            rows, symbol = layout.indices(v.name), old_model.symbol(v.name)
            if rows[0] not in control_kinks.corners:
                controls.append(symbol)
                values.append(symbol)
                continue
            labels = (choose_unused_variable_name(old_model, f"{v.name}_{end}") for end in ("plus", "minus"))
            plus, minus = (Symbol(replace(v, name=label)) for label in labels)
            corners = tuple(control_kinks.corners[i] for i in rows)
            parts = (plus.variable.name, minus.variable.name)
            split, difference = SplitControl(v, parts, corners if any(corners) else ()), plus - minus
            splits.append((split, difference + ca.DM(corners)))
            controls += [plus, minus]
            values += split.decompose_symbolic_control(symbol)
            excess |= dict(zip(rows, ca.vertsplit(plus), strict=True))
            pairs = zip(ca.vertsplit(symbol), ca.vertsplit(splits[-1][1]), strict=True)
            values_by_hash |= {element.element_hash(): value for element, value in pairs}

        def replace_kinks(name: str, expression: Any) -> Any:
            kinks = control_kinks.kinks.get(name, ())
            smooth = {k.node.element_hash(): k.base + k.factor * excess[k.control] for k in kinks}
            return substitute_split_controls(replace_subexpressions_by_hash(expression, smooth))

        def substitute_split_controls(expression: Any) -> Any:
            return replace_subexpressions_by_hash(expression, values_by_hash)

        model, paths, _ = substitute_controls_in_phase(phase, controls, splits, substitute_split_controls)
        replaced_symbols = ca.vertcat(*(old_model.symbol(c.name) for c, _ in splits))
        solved = ca.vertcat(*(value for _, value in splits))
        texts = []
        for control, _ in splits:
            corner = f"{', '.join(f'{c:g}' for c in control.corners)} + " if control.corners else ""
            shown = f"{corner}{' - '.join(control.parts)}"
            texts.append(f"{control.name} is replaced by {shown}, split at the kinks of its cost")
        return cls(
            model,
            paths,
            {name: (symbol, replace_kinks(name, e)) for name, (symbol, e) in phase.integrands.items()},
            ControlMap(old_model, replaced_symbols, solved, ca.vertcat(*values), tuple(texts)),
            tuple(c for c, _ in splits),
        )

    def reformulate_phase(self, phase: Phase) -> None:
        old, scales = phase.numbers, dict(phase.numbers.scales)
        boxes = split_bounds_by_name(old.controls, phase.model.controls)
        for control in self.controls:
            box, (plus, minus) = boxes[control.name], control.parts
            lower, upper = (control.decompose_control(end[:, None]) for end in (box.lower, box.upper))
            boxes[plus] = Interval(lower[0][:, 0], upper[0][:, 0])
            boxes[minus] = Interval(upper[1][:, 0], lower[1][:, 0])
            if control.name in scales:
                scales[plus] = scales[minus] = scales.pop(control.name)
        controls = stack_named_bounds(boxes, self.model.controls)
        self.apply_to_phase(phase, replace(old, controls=controls, scales=scales))
