"""Ranges of states and controls as users give them, by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gnc_opt.errors import ProblemError, unknown_name
from gnc_opt.model.composed import SplitControl, VectorControl
from gnc_opt.model.layout import Layout
from gnc_opt.model.model import Model
from gnc_opt.problem.interval import Interval, free, read_interval


def merged(old: Interval, layout: Layout, values: Mapping[str, Any], what: str, where: str) -> Interval:
    """Return an interval with the ranges of some names changed; ``what`` they are, and where, is for messages."""
    lower, upper = old.lower.copy(), old.upper.copy()
    for name, value in values.items():
        if name not in layout:
            raise unknown_name(layout.kind, name, where, layout.names)
        place = layout.slice(name)
        interval = read_interval(value, layout[name].size, f"the {what} of '{name}' in {where}")
        lower[place], upper[place] = interval.lower, interval.upper
    return Interval(lower, upper)


def without_negative_parts(model: Model) -> Interval:
    """Return the bounds of controls before any are stated: parts of split controls and magnitudes are >= 0."""
    box = free(model.controls.size)
    for control in model.composed_controls.values():
        for part in control.parts if isinstance(control, SplitControl) else control.parts[:1]:
            box.lower[model.controls.slice(part)] = 0.0
    return box


def one_sided(model: Model, ranges: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return ranges in which those of split controls are of their two parts: u = plus - minus."""
    parts: dict[str, Any] = {}
    for name, value in ranges.items():
        composed = model.composed_controls.get(name)
        if composed is None:
            parts[name] = value
            continue
        what = f"the bounds of '{name}' in {where}"
        if not isinstance(composed, SplitControl):
            raise ProblemError(
                f"{what} are those of a vector: give bounds_norm({name}=...), or path() for its components."
            )
        box = read_interval(value, composed.variable.size, what)
        if np.any(box.lower > 0) or np.any(box.upper < 0):
            raise ProblemError(
                f"{what} leave out zero, which a split control needs: declare it with control()."
            )
        plus, minus = composed.parts
        parts[plus] = (np.zeros(box.upper.size), box.upper)
        parts[minus] = (np.zeros(box.lower.size), -box.lower)
    return parts


def of_magnitudes(model: Model, ranges: Mapping[str, Any], where: str) -> dict[str, tuple[float, float]]:
    """Return ranges of the norms of vector controls as ranges of their magnitudes, which are >= 0."""
    parts = {}
    for name, value in ranges.items():
        what = f"the norm of '{name}' in {where}"
        vector = model.composed_controls.get(name)
        if not isinstance(vector, VectorControl):
            if name in model.controls or vector is not None:
                raise ProblemError(f"{what} has no bounds: declare '{name}' with vector_control().")
            known = [v.name for v in model.composed_controls.values() if isinstance(v, VectorControl)]
            raise unknown_name("vector control", name, where, known)
        box = read_interval(value, 1, what)
        if box.upper[0] < 0:
            raise ProblemError(f"{what} is at most {box.upper[0]:g}: give a limit >= 0.")
        parts[vector.magnitude] = (max(0.0, float(box.lower[0])), float(box.upper[0]))
    return parts
