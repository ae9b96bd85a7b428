"""Bounds of states and controls that are functions of time: path constraints, one for each end of a range."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from gnc_opt.errors import ProblemError
from gnc_opt.model.composed_controls import VectorControl
from gnc_opt.model.variables import as_expression
from gnc_opt.planning.problem.control_states import StatedPhase


def constant_ranges(leg: StatedPhase, ranges: Mapping[str, Any]) -> dict[str, Any]:
    """Return ranges with None for the ends that are functions of time, which become path constraints of a phase.

    Path constraints of earlier ranges of the same names are removed.

    Raises
    ------
    ProblemError
        A function has the wrong size or foreign symbols, or is no end of a range (lower, upper).
    """
    constant = dict(ranges)
    for name, value in ranges.items():
        for end in ("lower", "upper"):
            leg.drop_path(f"{end} bound of {name}")
        if _is_function(value):
            raise ProblemError(
                f"the bounds of '{name}' in {leg.where} are one function: write (lower, upper), or use path()."
            )
        if isinstance(value, tuple) and len(value) == 2:
            constant[name] = tuple(None if _is_function(end) else end for end in value)
            for end, limit in zip(("lower", "upper"), value, strict=True):
                if _is_function(limit):
                    _limit(leg, name, end, limit)
    return constant


def _is_function(end: Any) -> bool:
    return callable(end) or (isinstance(end, ca.SX) and not end.is_constant())


def _limit(leg: StatedPhase, name: str, end: str, limit: Any) -> None:
    """Add the path constraint of one end of a range: an expression, or a function of time that returns one."""
    model, what = leg.model, f"the {end} bound of '{name}' in {leg.where}"
    composed = model.composed_controls.get(name)
    if isinstance(composed, VectorControl):
        bounded = model.symbol(composed.magnitude)
    else:
        bounded = model.symbol(name) if composed is None else model.output_expression(name)
    value = as_expression(limit(model.time) if callable(limit) else limit, what, None, ProblemError)
    if value.shape[0] not in (1, bounded.shape[0]):
        raise ProblemError(f"{what} has {value.shape[0]} components: give 1 or {bounded.shape[0]}.")
    leg.path(f"{end} bound of {name}", bounded - value, **{end: 0.0})
