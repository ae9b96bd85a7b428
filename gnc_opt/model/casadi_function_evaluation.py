"""Numerical evaluation of CasADi functions of (t, x, ...).

CasADi calls a function once per column. For many columns, NumPy operations on whole rows are 3 to 300 times as fast;
results differ only by the rounding of transcendental functions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_float_array
from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError

NUMPY_MIN_COLUMNS_LONG, NUMPY_MAX_OPERATIONS = 100, 2000
"""Number of columns from which NumPy is faster for long functions, and the largest number of operations supported."""

NUMPY_MIN_COLUMNS_SHORT = 60
"""Number of columns from which NumPy is faster for short functions."""

CALL = 60
"""Overhead of a CasADi call, in operations on one column."""

_OPERATIONS: dict[int, Callable[..., Any]] = {
    ca.OP_ASSIGN: np.positive, ca.OP_ADD: np.add, ca.OP_SUB: np.subtract, ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide, ca.OP_NEG: np.negative, ca.OP_EXP: np.exp, ca.OP_LOG: np.log, ca.OP_POW: np.power,
    ca.OP_CONSTPOW: np.power, ca.OP_SQRT: np.sqrt, ca.OP_SQ: np.square, ca.OP_TWICE: lambda x: 2.0 * x,
    ca.OP_INV: np.reciprocal, ca.OP_SIN: np.sin, ca.OP_COS: np.cos, ca.OP_TAN: np.tan, ca.OP_ASIN: np.arcsin,
    ca.OP_ACOS: np.arccos, ca.OP_ATAN: np.arctan, ca.OP_ATAN2: np.arctan2, ca.OP_SINH: np.sinh,
    ca.OP_COSH: np.cosh, ca.OP_TANH: np.tanh, ca.OP_FABS: np.abs, ca.OP_FMIN: np.fmin, ca.OP_FMAX: np.fmax,
    ca.OP_HYPOT: np.hypot,
}  # fmt: skip
"""Supported operations; functions with others are evaluated by CasADi."""

_ACCESSES = (ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT)
"""Constant or argument row that is stored in a register, and register that is an output row."""


@dataclass(frozen=True)
class VectorizedFunction:
    """Operations of a CasADi function of column vectors whose first output is one dense column.

    Attributes
    ----------
    rows : int
        Number of rows of the output.
    registers : int
    steps : tuple
        Operation codes (``casadi.OP_...``) with result and operand registers.
    """

    rows: int
    registers: int
    steps: tuple[tuple[int, Sequence[int], Sequence[Any]], ...]

    @classmethod
    def from_casadi_function(cls, function: Any) -> VectorizedFunction | None:
        """Return the operations of a function; None if it is too long or has unsupported operations."""
        if not function.is_a("SXFunction") or not function.sparsity_out(0).is_dense():
            return None
        count = function.n_instructions()
        codes = [function.instruction_id(k) for k in range(count)]
        if count > NUMPY_MAX_OPERATIONS or not all(c in _OPERATIONS or c in _ACCESSES for c in codes):
            return None
        results = [function.instruction_output(k) for k in range(count)]
        given = [
            (function.instruction_constant(k),)
            if code == ca.OP_CONST
            else tuple(function.instruction_input(k))
            for k, code in enumerate(codes)
        ]
        return cls(function.size1_out(0), function.sz_w(), tuple(zip(codes, results, given, strict=True)))

    def is_faster_than_casadi(self, n: int) -> bool:
        """Return whether the evaluation is faster than CasADi for n columns."""
        return n * (CALL + len(self.steps)) > NUMPY_MIN_COLUMNS_LONG * len(self.steps)

    def __call__(self, n: int, *arguments: Array) -> Array:
        """Evaluate for arguments (rows,) or (rows, n); return (rows of the output, n)."""
        constant, argument, output = _ACCESSES
        register: list[Any] = [0.0] * self.registers
        found = np.zeros((self.rows, n))
        with np.errstate(all="ignore"):
            for code, result, given in self.steps:
                if code == constant:
                    register[result[0]] = given[0]
                elif code == argument:
                    register[result[0]] = arguments[given[0]][given[1]]
                elif code == output:
                    if result[0] == 0:
                        found[result[1]] = register[given[0]]
                elif len(given) == 1:
                    register[result[0]] = _OPERATIONS[code](register[given[0]])
                else:
                    register[result[0]] = _OPERATIONS[code](register[given[0]], register[given[1]])
        return found


BLOCK = 16
"""Largest number of evaluations per CasADi call."""

CACHED_FUNCTIONS = 256
"""Functions of which the layout is remembered: CasADi needs longer to report it than to evaluate them."""


def evaluate_casadi_function(
    function: Any,
    t: ArrayLike,
    x: ArrayLike,
    *others: ArrayLike,
    programme: Callable[[], VectorizedFunction | None] | None = None,
) -> Array:
    """Evaluate a CasADi function of (t, x, ...) at one time or many.

    1-D arguments are constant; 2-D ones have time as last axis. ``programme`` returns the NumPy version, if any.
    """
    times, *columns = read_casadi_function_arguments(function, t, x, *others)
    if (
        programme is not None
        and times.size >= NUMPY_MIN_COLUMNS_SHORT
        and (known := programme())
        and known.is_faster_than_casadi(times.size)
    ):
        return known(times.size, times.reshape(1, -1), *columns)
    found = evaluate_casadi_batch(function, times.size, times.reshape(1, -1), *columns)
    return found if times.ndim else found[:, 0]


def build_single_point_evaluator(function: Any, *constants: ArrayLike) -> Callable[..., Array]:
    """Return a function for the first output at one point, without conversion overhead, for integrators."""
    arguments = [np.zeros(function.size1_in(i)) for i in range(function.n_in())]
    free = len(arguments) - len(constants)
    for argument, value in zip(arguments[free:], constants, strict=True):
        argument[:] = value
    result = np.zeros(function.size1_out(0))
    buffer, run = function.buffer()
    for i, argument in enumerate(arguments):
        if argument.size:
            buffer.set_arg(i, memoryview(argument.data))
    if result.size:
        buffer.set_res(0, memoryview(result.data))

    def evaluate_function_at_single_point(*values: ArrayLike, _keep_alive: Any = buffer) -> Array:
        for argument, value in zip(arguments[:free], values, strict=True):
            argument[:] = value
        run()
        return result.copy()

    return evaluate_function_at_single_point


def evaluate_casadi_batch(function: Any, n: int, *arguments: Array) -> Array:
    """Return the first output (rows, n) of a CasADi function; arguments are (rows,) or (rows, n)."""
    block = max(min(n, BLOCK), 1)
    mapped, pattern, nonzeros = _map_casadi_function_over_points(function, block)
    if not nonzeros:
        return np.zeros((pattern.numel(), n))
    buffer, run = mapped.buffer()
    changing, kept = [], []
    for i, argument in enumerate(arguments):
        here = np.empty((block, argument.shape[0]))
        if argument.ndim == 1:
            here[:] = argument
        elif here.size:
            here[:] = argument[:, :1].T if n else 0.0  # also if the last block is not full
            changing.append((here, np.ascontiguousarray(argument.T)))
        if here.size:
            buffer.set_arg(i, here.ravel().data)
        kept.append(here)
    results = np.empty((block, nonzeros))
    buffer.set_res(0, results.ravel().data)
    found = np.empty((n, results.shape[1]))
    for first in range(0, n, block):
        places = slice(first, min(first + block, n))
        for here, argument in changing:
            here[: places.stop - first] = argument[places]
        run()
        found[places] = results[: places.stop - first]
    if pattern.is_dense():
        return np.ascontiguousarray(found.T)
    dense = np.zeros((pattern.numel(), n))
    dense[pattern.find()] = found.T
    return dense


@lru_cache(maxsize=CACHED_FUNCTIONS)
def _map_casadi_function_over_points(function: Any, block: int) -> tuple[Any, Any, int]:
    """Return the function of ``block`` points, and the pattern and number of nonzeros of the first output."""
    pattern = function.sparsity_out(0)
    return function.map(block), pattern, pattern.nnz()


def iterate_discrete_time_map(function: Any, start: Array, inputs: Array) -> Array:
    """Return the states (n_states, n + 1) of the recursion ``state = function(state, input)``."""
    states, columns = np.empty((inputs.shape[1] + 1, start.size)), np.ascontiguousarray(inputs.T)
    state, following, given = np.array(start, dtype=float), np.empty(start.size), np.empty(inputs.shape[0])
    buffer, run = function.buffer()
    buffer.set_arg(0, state.data)
    buffer.set_arg(1, given.data)
    buffer.set_res(0, following.data)
    states[0] = state
    for k, column in enumerate(columns, 1):
        given[:] = column
        run()
        states[k] = state[:] = following
    return np.ascontiguousarray(states.T)


def read_casadi_function_arguments(function: Any, *arguments: ArrayLike) -> list[Array]:
    """Return the arguments as arrays; raise `ArgumentError` for wrong shapes."""
    names, sizes = _list_argument_names_and_row_counts(function)
    arrays = [read_float_array(argument, name) for argument, name in zip(arguments, names, strict=False)]
    n_times = arrays[0].size
    for i, (array, rows) in enumerate(zip(arrays[1:], sizes[1:], strict=False), 1):
        if array.ndim == 0:
            arrays[i] = array = array.reshape(1)
        if array.shape[0] != rows or array.shape[1:] not in ((), (n_times,)):
            raise ArgumentError(
                f"{names[i]} has the shape {array.shape}: "
                f"give ({rows},) or ({rows}, {n_times}) for {n_times} time{'s' * (n_times != 1)}."
            )
    return arrays


@lru_cache(maxsize=CACHED_FUNCTIONS)
def _list_argument_names_and_row_counts(function: Any) -> tuple[list[str], list[int]]:
    """Return the names, for messages, and the numbers of rows of the arguments."""
    places = range(function.n_in())
    names = [f"{function.name_in(i)} of {function.name()}()" for i in places]
    return names, [function.size1_in(i) for i in places]


def take_runge_kutta_step(rates: Callable[..., Any], t: Any, h: Any, x: Any, controls: Sequence[Any]) -> Any:
    """Return the states after a classical Runge-Kutta step from time t over h, of numbers or symbols.

    ``rates`` is a function of time, states and controls; the controls are those at start, middle and end of the step.
    """
    k1 = rates(t, x, controls[0])
    k2 = rates(t + h / 2, x + h / 2 * k1, controls[1])
    k3 = rates(t + h / 2, x + h / 2 * k2, controls[1])
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rates(t + h, x + h * k3, controls[2]))
