"""What constraints say of a norm: a range of numbers, or another control as its largest value."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.problem.interval import Interval
from gnc_opt.problem.phase import Phase
from gnc_opt.tolerances import EQUAL

_SIZES = (0.7, 1.3, 2.1)


def limits_of(expression: Any, size: Any, limits: Interval) -> tuple[float, float] | None:
    """Return the range of a norm that limits of a scalar expression of it, linear or quadratic, amount to.

    None if the expression is of other things, too, or the range is empty.
    """
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
    """Return the place of the control that a constraint says is the most that a norm may be, or is the norm.

    It is >= 0, so that it can take the place of the magnitude.
    """
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
