"""The tables that a problem looks things up in: which ones, and where a trajectory is outside of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.model.evaluation import evaluate
from gnc_opt.model.graph import nodes_of
from gnc_opt.model.table import Table, TableUse
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.statement import Statement

SLACK = 1e-6
"""Share of an axis by which a trajectory may be outside of a table: an optimum at its edge is there to rounding."""


@dataclass(frozen=True)
class OutsideTable:
    """A trajectory leaves a table.

    Attributes
    ----------
    table : Table
    phase : str
    axis : int
        From 0.
    value : float
        The argument that is farthest outside.
    time : float
        When it is that, s.
    span : tuple of float
        First and last time outside, s.
    """

    table: Table
    phase: str
    axis: int
    value: float
    time: float
    span: tuple[float, float]

    def __str__(self) -> str:
        grid = self.table.grids[self.axis]
        argument = f"argument {self.axis + 1} " if len(self.table.grids) > 1 else ""
        first, last = self.span
        when = f"{first:.4g} s" if first == last else f"{first:.4g} to {last:.4g} s"
        return (
            f"'{self.table.name}' flown outside at t = {when} in phase {self.phase}: {argument}{self.value:.6g} "
            f"at t = {self.time:.4g} s, beyond {grid[0]:g} to {grid[-1]:g}"
        )


def along(leg: Phase) -> Any:
    """Return all expressions along a phase, stacked, in the symbols of its model."""
    return ca.vertcat(leg.model.derivative(), leg.path_expression(), leg.integrand_expression())


def table_uses(problem: Statement, leg: Phase) -> tuple[TableUse, ...]:
    """Return the calls of tables in what varies along a phase."""

    def find() -> tuple[TableUse, ...]:
        known = [*leg.model.table_uses(), *problem.parameter_table_uses()]
        if not known:
            return ()
        present = {node.element_hash() for node in nodes_of(along(leg))}
        return tuple({id(use): use for use in known if use.hashes & present}.values())

    return problem.once(("tables", leg.name), find)


def outside_tables(
    problem: Statement, leg: Phase, times: Array, states: Array, controls: Array, p: Array, q: Array
) -> list[OutsideTable]:
    """Return where a trajectory is outside of tables.

    Parameters
    ----------
    times : array (N,)
    states, controls : array (n_states, N), (n_controls, N)
    p, q : array
        Values of the model's and of the problem's free parameters.
    """
    uses = table_uses(problem, leg)
    if not uses:
        return []
    arguments = evaluate(_arguments(problem, leg, uses), times, states, controls, p, q)
    found, row = [], 0
    for use in uses:
        for axis, grid in enumerate(use.table.grids):
            beyond = np.maximum(grid[0] - arguments[row], arguments[row] - grid[-1])
            out = np.flatnonzero(beyond > SLACK * (grid[-1] - grid[0]))
            if out.size:
                worst = int(np.argmax(beyond))
                span = (float(times[out[0]]), float(times[out[-1]]))
                value, when = float(arguments[row, worst]), float(times[worst])
                found.append(OutsideTable(use.table, leg.name, axis, value, when, span))
            row += 1
    return found


def _arguments(problem: Statement, leg: Phase, uses: tuple[TableUse, ...]) -> Any:
    """The function (t, x, u, p, q) -> all arguments of all tables."""

    def build() -> Any:
        stacked = ca.densify(ca.vertcat(*(use.arguments for use in uses)))
        names = ["t", "x", "u", "p", "q"]
        inputs = [*leg.model.arguments(), problem.parameter_symbols()]
        return ca.Function("tables", inputs, [problem.bind(leg, stacked)], names, ["arguments"])

    return problem.once(("table arguments", leg.name), build)
