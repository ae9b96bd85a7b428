"""Folded: the step of a kernel, many control steps of a run and the flights beside it in one call."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.simulation.kernel import Kernel
from gnc_opt.simulation.native import loaded


class Folded:
    """The step of a kernel, folded.

    Parameters
    ----------
    kernel : Kernel
    library : str
        Of `quick` as machine code; "" for the interpreter.
    """

    def __init__(self, kernel: Kernel, library: str = "") -> None:
        self.kernel, self.library = kernel, library
        self._buffers: dict[Any, Any] = {}

    def fly(self, X: Array, rows: Array, C: Array, final: Array) -> None:
        """Write the states after the steps of a leg to ``final``.

        Parameters
        ----------
        X : array (n_flights, n_state)
        rows : array (n_steps, n_known)
        C : array (n_constants,)
        final : array (n_flights, n_state)
        """
        if not len(X):
            return
        if self._native is None:
            self._interpret(X, rows, C, final)
            return
        flown = self._native(X, rows, C, final)
        while flown < len(rows):  # a step that is not easy
            self._interpret(final.copy(), rows[flown : flown + 1], C, final)
            flown += 1
            flown += self._native(final.copy(), rows[flown:], C, final)

    def begun(self, known: Array, P: Array) -> tuple[Array, Array]:
        """Return X at the first step (n_state,), and the constants of a run (n_constants,)."""
        start, constants = self.kernel.start, self.kernel.constants
        X, C = np.empty(start.size1_out(0)), np.empty(constants.size1_out(0))
        P = np.ascontiguousarray(P)
        self._evaluate("start", lambda: start, (np.ascontiguousarray(known), P), X)
        self._evaluate("constants", lambda: constants, (P,), C)
        return X, C

    def _interpret(self, X: Array, rows: Array, C: Array, final: Array) -> None:
        """The same, by the interpreter."""

        def leg() -> Any:
            return self._leg(lambda x, w, c, n: [self.step.fold(n)(x, w, c)], len(rows))

        for x, end in zip(X, final, strict=True):
            self._evaluate(len(rows), leg, (x, rows, C), end)

    def _evaluate(
        self, key: Any, function: Callable[[], Any], arguments: tuple[Array, ...], *results: Array
    ) -> None:
        """Write what a function makes of contiguous arrays to others: no conversion per run."""
        if key not in self._buffers:
            self._buffers[key] = function().buffer()
        buffer, evaluate = self._buffers[key]
        for k, array in enumerate(arguments):
            buffer.set_arg(k, memoryview(array.data))
        for k, result in enumerate(results):
            buffer.set_res(k, memoryview(result.data))
        evaluate()

    def logged(self, X: Array, rows: Array, C: Array) -> tuple[Array, Array, Array]:
        """Return the states of the run, the first flight, before and after the steps of a leg (n_state, n_steps + 1),
        the logs of its steps (n_log, n_steps), and the states of all flights after the last (n_flights, n_state)."""
        count, step = len(rows), self.kernel.step
        columns, logs, final = (
            np.empty(shape) for shape in ((count + 1, X.shape[1]), (count, self.kernel.log.size), X.shape)
        )

        def leg() -> Any:
            return self._leg(lambda x, w, c, n: [ca.densify(o) for o in step.mapaccum(n)(x, w, c)], count)

        columns[0] = X[0]
        self._evaluate(("logged", count), leg, (columns[0], rows, C), columns[1:], logs)
        final[0] = columns[-1]
        self.fly(X[1:], rows, C, final[1:])
        return columns.T, logs.T, final

    @cached_property
    def _native(self) -> Callable[[Array, Array, Array, Array], int] | None:
        return loaded(self.library)

    @property
    def quick(self) -> Any:
        """What machine code is made of."""
        return self.kernel.easy or self.step

    @cached_property
    def step(self) -> Any:
        """The step without its log, so that what only the log needs is not computed."""
        step = self.kernel.step
        symbols = step.sx_in() if step.is_a("SXFunction") else step.mx_in()
        return ca.Function("only", symbols, [step(*symbols)[0]], ["X", "w", "C"], ["X_next"])

    def _leg(self, outputs: Callable[[Any, Any, Any, int], list[Any]], count: int) -> Any:
        step = self.kernel.step
        x, w, c = (ca.MX.sym(n, *size) for n, size in (
            ("X", (self.kernel.state.size,)), ("w", (self.kernel.known.size, count)), ("C", (step.size1_in(2),))
        ))  # fmt: skip
        return ca.Function("leg", [x, w, c], outputs(x, w, ca.repmat(c, 1, count), count))
