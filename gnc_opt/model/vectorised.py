"""CasADi functions by NumPy, an operation on all columns at a time.

CasADi calls a function once per column, which for the short expressions of most models takes several times as long as
what it computes. Where columns are many, one NumPy operation after another on all of them is the quicker way, by a
factor of 3 to 300. Results differ from CasADi's by the rounding of transcendental functions at most.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array

MANY, LONGEST = 100, 2000
"""Columns for which long programmes are quicker by NumPy, and operations of the longest that is read."""

FEWEST = 60
"""Columns for which short programmes are quicker by NumPy."""

CALL = 60
"""What a call of CasADi takes, in operations on one column."""

Operation: TypeAlias = Callable[..., Any]


def _twice(values: Any) -> Any:
    return 2.0 * values


def _constant() -> None:
    """Marks a number that is put into a register."""


def _given() -> None:
    """Marks a row of an argument that is put into a register."""


def _told() -> None:
    """Marks a register that is a row of the output."""


_OPERATIONS: dict[int, Operation] = {
    ca.OP_ASSIGN: np.positive,
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_NEG: np.negative,
    ca.OP_EXP: np.exp,
    ca.OP_LOG: np.log,
    ca.OP_POW: np.power,
    ca.OP_CONSTPOW: np.power,
    ca.OP_SQRT: np.sqrt,
    ca.OP_SQ: np.square,
    ca.OP_TWICE: _twice,
    ca.OP_INV: np.reciprocal,
    ca.OP_SIN: np.sin,
    ca.OP_COS: np.cos,
    ca.OP_TAN: np.tan,
    ca.OP_ASIN: np.arcsin,
    ca.OP_ACOS: np.arccos,
    ca.OP_ATAN: np.arctan,
    ca.OP_ATAN2: np.arctan2,
    ca.OP_SINH: np.sinh,
    ca.OP_COSH: np.cosh,
    ca.OP_TANH: np.tanh,
    ca.OP_FABS: np.abs,
    ca.OP_FMIN: np.fmin,
    ca.OP_FMAX: np.fmax,
    ca.OP_HYPOT: np.hypot,
}
"""What is read; functions with other operations are left to CasADi."""


@dataclass(frozen=True)
class Operations:
    """The operations of a CasADi function of columns with one dense column as its first output.

    Attributes
    ----------
    rows : int
        Of the output.
    registers : int
    steps : tuple of (operation, place of its result, what it is given)
        A place is a register, or a row of the output; given are registers, a number, or an argument and its row.
    """

    rows: int
    registers: int
    steps: tuple[tuple[Operation, int, Sequence[Any]], ...]

    @classmethod
    def of(cls, function: Any) -> Operations | None:
        """Read a function; None if it is too long, or has operations beyond those known here."""
        if not function.is_a("SXFunction") or not function.sparsity_out(0).is_dense():
            return None
        if function.n_instructions() > LONGEST:
            return None
        steps: list[tuple[Operation, int, Sequence[Any]]] = []
        for k in range(function.n_instructions()):
            code, given, result = (
                function.instruction_id(k),
                function.instruction_input(k),
                function.instruction_output(k),
            )
            if code == ca.OP_CONST:
                steps.append((_constant, result[0], (function.instruction_constant(k),)))
            elif code == ca.OP_INPUT:
                steps.append((_given, result[0], tuple(given)))
            elif code == ca.OP_OUTPUT:
                if result[0] == 0:
                    steps.append((_told, result[1], tuple(given)))
            elif code in _OPERATIONS:
                steps.append((_OPERATIONS[code], result[0], tuple(given)))
            else:
                return None
        return cls(function.size1_out(0), function.sz_w(), tuple(steps))

    def pays(self, n: int) -> bool:
        """Whether it is quicker than CasADi for n columns."""
        return n * (CALL + len(self.steps)) > MANY * len(self.steps)

    def __call__(self, n: int, *arguments: Array) -> Array:
        """Evaluate with arguments (rows,) or (rows, n), (rows of the output, n)."""
        register: list[Any] = [0.0] * self.registers
        found = np.zeros((self.rows, n))
        with np.errstate(all="ignore"):
            for operation, place, given in self.steps:
                if operation is _told:
                    found[place] = register[given[0]]
                elif operation is _given:
                    register[place] = arguments[given[0]][given[1]]
                elif operation is _constant:
                    register[place] = given[0]
                elif len(given) == 1:
                    register[place] = operation(register[given[0]])
                else:
                    register[place] = operation(register[given[0]], register[given[1]])
        return found
