"""Numeric calls of CasADi functions of (t, x, ...)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import read_numbers
from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.model.vectorised import FEWEST, Operations

BLOCK = 16
"""So many evaluations are one call of CasADi, at most."""


def evaluate(
    function: Any,
    t: ArrayLike,
    x: ArrayLike,
    *others: ArrayLike,
    programme: Callable[[], Operations | None] | None = None,
) -> Array:
    """Evaluate a CasADi function of (t, x, ...) at one time or many.

    One-dimensional arguments are constant in time; two-dimensional ones have time as the last axis. ``programme`` tells
    the function as one of NumPy, if it is one, for times that are many.
    """
    times, *columns = checked(function, t, x, *others)
    if programme is not None and times.size >= FEWEST and (known := programme()) and known.pays(times.size):
        return known(times.size, times.reshape(1, -1), *columns)
    found = evaluate_columns(function, times.size, times.reshape(1, -1), *columns)
    return found if times.ndim else found[:, 0]


def fast_call(function: Any, *constants: ArrayLike) -> Callable[..., Array]:
    """Return a CasADi function's first output at one point, without conversion overhead, for integrators.

    Parameters
    ----------
    function : casadi.Function
        With dense arguments and output.
    *constants : array
        Its last arguments, once and for all; what is returned takes the others.
    """
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

    def call(*values: ArrayLike, _keep_alive: Any = buffer) -> Array:
        for argument, value in zip(arguments[:free], values, strict=True):
            argument[:] = value
        run()
        return result.copy()

    return call


def evaluate_columns(function: Any, n: int, *arguments: Array) -> Array:
    """Evaluate a CasADi function of columns n times, its first output as columns of the result, (rows, n).

    In place, by blocks: converting whole matrices to CasADi's and back takes ten times as long as evaluating.

    Parameters
    ----------
    function : casadi.Function
    n : int
        Evaluations.
    *arguments : array (rows,) or (rows, n)
        What stays the same, or one column each time; double precision.
    """
    pattern = function.sparsity_out(0)
    if not pattern.nnz():
        return np.zeros((pattern.numel(), n))
    block = max(min(n, BLOCK), 1)
    mapped = function.map(block) if block > 1 else function
    buffer, run = mapped.buffer()
    changing, kept = [], []
    for i, argument in enumerate(arguments):
        here = np.empty((block, argument.shape[0]))
        if argument.ndim == 1:
            here[:] = argument
        elif here.size:
            here[:] = argument[:, :1].T if n else 0.0  # also where the last block is not full
            changing.append((here, np.ascontiguousarray(argument.T)))
        if here.size:
            buffer.set_arg(i, here.reshape(-1).data)
        kept.append(here)
    results = np.empty((block, pattern.nnz()))
    buffer.set_res(0, results.reshape(-1).data)
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


def evaluate_chain(function: Any, start: Array, inputs: Array) -> Array:
    """Evaluate a CasADi function of (state, input) again and again, each time with the state that it gave before.

    Parameters
    ----------
    function : casadi.Function
        Dense columns in, a dense column out.
    start : array (n_states,)
    inputs : array (n_inputs, n)

    Returns
    -------
    array (n_states, n + 1)
        The start and every state after it.
    """
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


def checked(function: Any, *arguments: ArrayLike) -> list[Array]:
    """Return the arguments as arrays; raise `ArgumentError` for those that the function cannot take."""
    arrays = [
        read_numbers(a, f"{function.name_in(i)} of {function.name()}()") for i, a in enumerate(arguments)
    ]
    n_times = arrays[0].size
    for i, array in enumerate(arrays[1:], 1):
        rows = function.size1_in(i)
        if array.ndim == 0:
            arrays[i] = array = array.reshape(1)
        if array.shape[0] != rows or array.shape[1:] not in ((), (n_times,)):
            raise ArgumentError(
                f"{function.name_in(i)} of {function.name()}() has the shape {array.shape}: "
                f"give ({rows},) or ({rows}, {n_times}) for {n_times} time{'s' * (n_times != 1)}."
            )
    return arrays
