"""C code of the condensed MPC quadratic program, solved by the active-set method in ``active_set_qp.c``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.control.c_export.c_statement_generation import CFloatType
from gnc_opt.control.control_limits_and_authority import clip_to_limits
from gnc_opt.control.discrete_time_controller import (
    CodegenLaw,
    Controller,
    initial_state_function,
    law_function,
)
from gnc_opt.control.feedforward_and_reference_schedule import (
    ReferenceSchedule,
    build_reference_signal_layout,
)
from gnc_opt.control.mpc_horizon_qp import StepLimits
from gnc_opt.control.tracking_error_dynamics import ErrorDynamics
from gnc_opt.model.model_variables import Layout, Variable
from gnc_opt.numerical_tolerances import LARGEST, set_nonfinite_to_zero

_SOURCE = Path(__file__).with_name("active_set_qp.c")
_ITERATIONS_PER_UNKNOWN = 20
"""Largest number of iterations per unknown; random programs needed at most nine."""


@dataclass(frozen=True, eq=False)
class QpCode:
    """C code of the QP of a horizon; step j of the horizon from row k of the schedule uses the matrices k + j."""

    rows: StepLimits
    roots: Array
    matrices: tuple[Array, ...]
    count: int
    n_states: int

    @property
    def n_qp_variables(self) -> int:
        return self.count * (self.rows.lower.size + self.roots.size)

    @property
    def n_qp_constraints(self) -> int:
        return self.count * self._n_qp_constraints_per_step

    @property
    def max_operation_count(self) -> int:
        """Largest number of arithmetic operations and comparisons of a call."""
        m, size = self.rows.lower.size, self.n_qp_variables
        n = self.matrices[0].shape[1]
        sweep = self.count * (2 * (n + m) ** 2 + 6 * (self._n_qp_constraints_per_step + n + m))
        row = 2 * sweep + size * (size + 3)
        iteration = (
            2 * sweep + 6 * self.n_qp_constraints + 2 * size * (size + 8) + row + 3 * size * (size + 3)
        )
        return int(self._max_qp_iterations * iteration + self.count * self.roots.size * row + 2 * m * (n + m))

    @property
    def max_stack_float_count(self) -> int:
        """Largest number of entries on the stack of a call."""
        m, size = self.rows.lower.size, self.n_qp_variables
        n = self.matrices[0].shape[1]
        active = (size + 1) * (size + 2) // 2 + 5 * (size + 1) + 1
        return int(active + 4 * self.n_qp_constraints + 6 * (size + 1) + 2 * n + 3 * m)

    def write_qp_solver_code(self, numbers: CFloatType) -> str:
        """Return the C code, to be placed after a table ``schedule[N_ROWS][.]``."""
        rows, m, n = self.rows, self.rows.lower.size, self.matrices[0].shape[1]
        slack = [
            rows.soft_limited_states.index(i) if i in rows.soft_limited_states else -1
            for i in range(len(rows.states))
        ]
        sizes = {
            "HORIZON": self.count, "N_E": n, "N_U": m, "N_X": self.n_states, "N_L": len(rows.states),
            "N_S": self.roots.size, "RATES": int(rows.change is not None), "N_TABLES": len(self.matrices[0]),
            "MOST": self._max_qp_iterations, "NONE": numbers(LARGEST), "TOLERANCE": numbers(numbers.solved),
            "DEPENDENT": numbers(numbers.dependent)
        }  # fmt: skip
        scale = 1 / rows.state_scale
        change = np.ones(m) if rows.change is None else rows.change
        arrays = {
            "command_middle": 0.5 * (rows.upper + rows.lower), "command_scale": 2 / (rows.upper - rows.lower),
            "rate_scale": 1 / change, "state_scale": scale, "slack_root": self.roots,
            "state_lower": set_nonfinite_to_zero(rows.state_lower),
            "state_upper": set_nonfinite_to_zero(rows.state_upper),
            "row_lower": self._qp_constraint_limits[0], "row_upper": self._qp_constraint_limits[1]
        }  # fmt: skip
        index_tables = {"limited_error": rows.errors, "limited_state": rows.states, "limited_slack": slack}
        lines = [f"#define {name} {value}" for name, value in sizes.items()]
        lines += [
            "",
            "typedef struct {",
            f"    {numbers.type} a[N_E][N_E], f[N_E][N_U], k[N_U][N_E], g[N_U][N_U];",
        ]
        lines += ["} matrices;", ""]
        lines += [
            numbers.write_c_array_definition(name, values if values.size else np.zeros(1))
            for name, values in arrays.items()
        ]
        for name, indices in index_tables.items():
            lines.append(f"static const int {name}[] = {{{', '.join(map(str, indices or (0,)))}}};")
        steps = [
            "{" + ", ".join(numbers.format_c_initializer(table[k]) for table in self.matrices) + "}"
            for k in range(len(self.matrices[0]))
        ]
        lines += ["static const matrices steps[N_TABLES] = {", ",\n".join(steps), "};", ""]
        lines += [
            "static const matrices *matrices_of(long first, int j)",
            "{",
            "    const long k = first + j;",
            "    return &steps[k < N_TABLES ? k : N_TABLES - 1];",
            "}",
            "",
        ]
        return "\n".join([*lines, numbers.substitute_c_float_type(_SOURCE.read_text(encoding="ascii"))])

    @property
    def _n_qp_constraints_per_step(self) -> int:
        rows = self.rows
        return rows.lower.size * (1 + (rows.change is not None)) + 2 * len(rows.states) + self.roots.size

    @property
    def _max_qp_iterations(self) -> int:
        return _ITERATIONS_PER_UNKNOWN * (self.n_qp_variables + 1)

    @property
    def _qp_constraint_limits(self) -> tuple[Array, Array]:
        rows, soft = self.rows, self.roots.size
        m = rows.lower.size * (1 + (rows.change is not None))
        states = len(rows.states)
        unlimited = np.full(states, LARGEST)
        lower_states = np.where(np.isfinite(rows.state_lower), 0.0, -LARGEST)
        upper_states = np.where(np.isfinite(rows.state_upper), 0.0, LARGEST)
        low = np.concatenate([np.full(m, -1.0), lower_states, -unlimited, np.zeros(soft)])
        high = np.concatenate([np.full(m, 1.0), unlimited, upper_states, np.full(soft, LARGEST)])
        return low, high


def build_mpc_memory_layout(m: int) -> Layout:
    """Return the layout of an MPC memory: the previous command (m,) and the alarm."""
    parts = (Variable("previous_command", m), Variable("qp_failed", 1))
    return Layout("memory", parts, "the memory of the controller")


def clip_command_and_rate(u: Any, previous: Any, rows: StepLimits) -> Any:
    """Return a command clipped to the limits of magnitude and rate, SX or MX."""
    lower, upper = ca.DM(rows.lower), ca.DM(rows.upper)
    if rows.change is not None:
        lower, upper = ca.fmax(lower, previous - rows.change), ca.fmin(upper, previous + rows.change)
    return clip_to_limits(u, lower, upper)


def build_mpc_law_for_c_export(
    code: QpCode, deviation: ErrorDynamics, controller: Controller, reference: Any
) -> CodegenLaw:
    model, m, rows = deviation.model, code.rows.lower.size, code.rows
    signals = build_reference_signal_layout(reference, Variable("row", 1))
    t, x = ca.SX.sym("t"), ca.SX.sym("x", model.states.size)
    r, z = ca.SX.sym("r", signals.size), ca.SX.sym("z", m + 1)
    x_ref, u_ff, number = ca.vertsplit(r, [0, x.numel(), x.numel() + m, x.numel() + m + 1])
    previous, alarm = ca.vertsplit(z, [0, m, m + 1])
    e = deviation.state_error_expression(x, x_ref)
    v, solved = _declare_external_qp_solver(e.numel(), m)(number, e, previous)
    u = clip_command_and_rate(u_ff + v, previous, rows)
    first = ca.vertcat(clip_to_limits(u_ff, rows.lower, rows.upper), 0)
    assert controller.dt is not None and controller.span is not None
    form = Controller(
        name=controller.name,
        step=law_function(t, x, r, z, u, ca.vertcat(u, ca.if_else(solved, alarm, 1))),
        start=initial_state_function(t, x, r, first),
        states=controller.states,
        commands=controller.commands,
        signals=signals,
        memory=controller.memory,
        schedule=_IndexedSchedule(ReferenceSchedule(reference), controller.span),
        explanation=controller.explanation,
        dt=controller.dt,
        alarms=controller.alarms,
        span=controller.span,
    )
    return CodegenLaw(form, code)


@dataclass(frozen=True, eq=False)
class _IndexedSchedule:
    """Rows of a reference schedule, each followed by its index in the C table."""

    reference: ReferenceSchedule
    span: tuple[float, float]

    def __call__(self, times: Array, dt: float) -> Array:
        first, last = self.span
        numbers = np.clip(np.floor((times - first) / dt + 1e-6), 0, np.ceil((last - first) / dt - 1e-9))
        return np.vstack([self.reference(times, dt), numbers])


def _declare_external_qp_solver(n: int, m: int) -> Any:
    """Return a function that stands for the QP solver in the exported law; it returns NaN in Python."""
    inputs = [ca.SX.sym("row"), ca.SX.sym("e", n), ca.SX.sym("before", m)]
    nans = [ca.SX.nan(m, 1) if hasattr(ca.SX, "nan") else ca.SX(ca.DM(np.full(m, np.nan))), ca.SX(np.nan)]
    return ca.Function("programme", inputs, nans, {"never_inline": True})
