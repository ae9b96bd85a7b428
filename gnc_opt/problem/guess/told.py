"""What boundary constraints tell about the ends of phases, for the guess: a lift-off mass that is a sum of parts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.problem.constraint import Constraint
from gnc_opt.problem.phase import Phase


def note_told_ends(
    constraint: Constraint, legs: Iterable[Phase], parameters: Any, guess: Mapping[str, Array]
) -> None:
    """Note in phases the values at which rows of a constraint hold that are affine in one end state alone.

    Free parameters in them are as guessed (the stacked symbols of all, and their guesses). Of a range it is the
    middle, of an inequality the limit.
    """
    owners = {
        symbol.element_hash(): (leg, end, name, i)
        for leg in legs
        for end, state in (("initial", leg.initial_state), ("final", leg.final_state))
        for name in leg.model.states.names
        for i, symbol in enumerate(ca.vertsplit(state(name)))
    }
    known = {symbol.element_hash() for symbol in ca.vertsplit(parameters)}
    numbers = np.concatenate([*guess.values(), np.zeros(0)])
    for row, wanted in zip(ca.vertsplit(constraint.expression), constraint.interval.middle, strict=True):
        symbols = [s for s in ca.symvar(row) if s.element_hash() not in known]
        if len(symbols) != 1 or symbols[0].element_hash() not in owners:
            continue
        slope = ca.jacobian(row, symbols[0])
        if ca.depends_on(slope, symbols[0]):
            continue
        at_zero, rate = (
            float(v) for v in ca.Function("f", [symbols[0], parameters], [row, slope])(0.0, numbers)
        )
        value = (wanted - at_zero) / rate if rate else np.nan
        if np.isfinite(value):
            leg, end, name, i = owners[symbols[0].element_hash()]
            leg.note_told(end, name, i, value)
