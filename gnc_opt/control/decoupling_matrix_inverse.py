"""Control laws that invert a decoupling matrix, with a fallback command where the matrix is nearly singular.

Near a singularity the law raises the alarm ``singular`` and returns the fallback or its last command. Its
memory does not change until the matrix is regular again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.argument_checks import read_positive_number
from gnc_opt.control.design_report import DesignReport, ReportEntry, format_number
from gnc_opt.control.discrete_time_controller import (
    Controller,
    Schedule,
    initial_state_function,
    law_function,
)
from gnc_opt.control.feedforward_and_reference_schedule import (
    ReferenceSchedule,
    StackedSchedule,
    build_reference_signal_layout,
    choose_reference_sample_times,
)
from gnc_opt.control.input_output_linearization import OutputErrors, PlantPair, zero_dynamics
from gnc_opt.control.measurement_dropouts import with_dropout_handling
from gnc_opt.control.reference_trajectory import Reference
from gnc_opt.errors import DesignError
from gnc_opt.model.model_variables import Layout, Variable
from gnc_opt.numerical_tolerances import is_rank_deficient

SINGULAR = "singular"
"""Name of the alarm."""
DETERMINANT_MIN_SHARE = 0.05
"""Smallest |det E| at which the law is applied, relative to the largest on the reference."""
ZERO_DYNAMICS_MAX_GROWTH = 1e-9
"""Zero dynamics count as unstable when they grow faster than this, 1/s."""


@dataclass(frozen=True, eq=False)
class MemoryEntry:
    """Part of a law's memory: symbol, initial and next value (SX columns), and whether it is an alarm."""

    name: str
    symbol: Any
    start: Any
    after: Any
    unit: str = ""
    alarm: bool = False

    @property
    def memory_variable(self) -> Variable:
        return Variable(self.name, self.symbol.numel(), self.unit)


@dataclass(frozen=True, eq=False)
class GuardedInverse:
    """Inverse of a decoupling matrix E; ``regular`` (SX) is 1 where |det E| >= ``lowest`` * ``scale``."""

    matrix: Any
    regular: Any
    scale: float
    lowest: float

    @property
    def smallest_decoupling_determinant(self) -> ReportEntry:
        """Return the smallest |det E| on the reference."""
        name, remark = "smallest determinant on the reference", f"largest {self.scale:.6g}"
        return ReportEntry(name, self.lowest, remark=remark)

    def __call__(self, y: Any) -> Any:
        """Return E^+ y, SX; an arbitrary finite value where E is singular."""
        return _solve_minimum_norm_system(self.matrix, y)


def build_guarded_decoupling_inverse(
    errors: OutputErrors, reference: Reference, guard: float
) -> GuardedInverse:
    """Return the guarded inverse; `DesignError` if det E changes sign or is too small on the reference."""
    guard = read_positive_number(guard, "the guard of a design", DesignError, or_zero=True)
    pair, matrix, determinant = errors.pair, errors.decoupling, errors.decoupling_determinant
    times = choose_reference_sample_times(reference)
    values = np.array([v[0, 0] for v in pair.evaluate_expression_on_reference(reference, times, determinant)])
    scale = float(np.max(np.abs(values)))
    signed = values * np.sign(values[int(np.argmax(np.abs(values)))])
    worst = int(np.argmin(signed))
    is_singular = not np.all(np.isfinite(values)) or signed[worst] < guard * scale
    there = pair.evaluate_expression_on_reference(reference, times[[worst]], matrix)[0]
    if is_singular or is_rank_deficient(np.linalg.svd(there, compute_uv=False)):
        raise DesignError(
            f"the decoupling matrix of outputs {', '.join(errors.labels)} is singular on the reference: det E = "
            f"{values[worst]:.3g} at t = {times[worst]:.6g} s, where its largest value is {scale:.3g}; "
            "choose other outputs or a reference that keeps clear, or make the control that enters first a state and "
            "its rate the control."
        )
    if matrix.is_constant():
        return GuardedInverse(ca.SX(matrix), ca.SX(1), scale, scale)
    sign = float(np.sign(values[worst]))
    regular = sign * determinant >= guard * scale
    safe = ca.if_else(regular, matrix, ca.SX(np.eye(*matrix.shape)))
    return GuardedInverse(ca.densify(safe), regular, scale, float(signed[worst]))


def require_stable_zero_dynamics(
    errors: OutputErrors, reference: Reference, growth: float
) -> list[ReportEntry]:
    """Return the zero dynamics at the end of the reference; raise `DesignError` if they are unstable."""
    t = reference.final_time
    zeros = zero_dynamics(errors, t, reference.x(t), reference.u(t))
    if zeros.growth_rate > growth:
        worst = zeros.eigenvalues[int(np.argmax(zeros.eigenvalues.real))]
        raise DesignError(
            f"the zero dynamics of outputs {', '.join(errors.labels)} are unstable: "
            f"eigenvalue {format_number(worst)} 1/s of {zeros.dimension} at the end of the reference; "
            "steer other outputs or another mix of them."
        )
    facts = [ReportEntry("dimension of the zero dynamics", zeros.dimension)]
    if zeros.dimension:
        remark = "frozen at the end of the reference"
        facts.append(ReportEntry("eigenvalues of the zero dynamics", zeros.eigenvalues, "1/s", remark))
    return facts


@dataclass(frozen=True, eq=False)
class GuardedLaw:
    """Command (n_controls,), its validity, its memory, and the fallback (default: the last command)."""

    command: Any
    regular: Any
    memory: tuple[MemoryEntry, ...] = ()
    fallback: Any = None
    nominal: NominalController | None = None


def build_singularity_guarded_controller(
    name: str,
    pair: PlantPair,
    reference: Reference,
    guarded: GuardedLaw,
    *,
    dt: float | None,
    explanation: DesignReport,
) -> Controller:
    memory, nominal = guarded.memory, guarded.nominal
    last = ca.SX.sym("u_last", pair.u.numel())
    singular, regular = ca.SX.sym(SINGULAR), guarded.regular
    u = ca.if_else(regular, guarded.command, last if guarded.fallback is None else guarded.fallback)
    entries = [
        *memory,
        MemoryEntry("u_last", last, pair.u_ref, u),
        MemoryEntry(SINGULAR, singular, ca.SX(0), ca.fmax(singular, ca.logic_not(regular))),
    ]
    z = ca.vertcat(*[part.symbol for part in entries])
    start = ca.vertcat(*[part.start for part in entries])
    frozen = [ca.if_else(regular, part.after, part.symbol) for part in memory]
    after = ca.vertcat(*frozen, *[part.after for part in entries[len(memory) :]])
    inner_signals: list[Variable] = []
    variables = [part.memory_variable for part in entries]
    r = ca.vertcat(pair.x_ref, pair.u_ref)
    schedule: Schedule = ReferenceSchedule(reference)
    alarms: tuple[str, ...] = (*(part.name for part in memory if part.alarm), SINGULAR)
    if nominal is not None:
        variables += nominal.nominal_memory_variables
        inner_signals = nominal.nominal_signal_variables
        alarms += tuple(f"nominal_{alarm}" for alarm in nominal.controller.alarms)
        schedule = StackedSchedule(schedule, nominal.controller.schedule)
        z, r = ca.vertcat(z, nominal.z), ca.vertcat(r, nominal.r)
        start = ca.vertcat(start, nominal.start)
        after = ca.vertcat(after, nominal.after)
    model = pair.model
    guarded_law = Controller(
        name=name,
        step=law_function(pair.t, pair.x, r, z, u, after),
        start=initial_state_function(pair.t, pair.x, r, start),
        states=model.states,
        commands=model.controls,
        signals=build_reference_signal_layout(reference, *inner_signals),
        memory=Layout("memory", tuple(variables), f"controller '{name}'"),
        schedule=schedule,
        explanation=explanation,
        dt=dt,
        span=(reference.initial_time, reference.final_time),
        alarms=alarms,
    )
    return with_dropout_handling(guarded_law)


class NominalController:
    """Nominal controller inside another law, evaluated on the symbols of the outer law."""

    def __init__(self, controller: Controller, pair: PlantPair) -> None:
        controller = controller.without_dropout_handling or controller  # the outer law handles dropouts
        if controller.states.labels != pair.model.states.labels:
            raise DesignError(
                f"the nominal controller '{controller.name}' is for other states than model '{pair.model.name}'."
            )
        if controller.commands.labels != pair.model.controls.labels:
            raise DesignError(
                f"the nominal controller '{controller.name}' commands other controls than model "
                f"'{pair.model.name}' has."
            )
        if not controller.step.is_a("SXFunction"):
            raise DesignError(
                f"the nominal controller '{controller.name}' solves a program at every step: "
                "integral sliding mode needs a nominal law in closed form, such as LQR."
            )
        self.controller = controller
        self.r = ca.SX.sym("r_nominal", controller.signals.size)
        self.z = ca.SX.sym("z_nominal", controller.memory.size)
        self.command, self.after = controller.step(pair.t, pair.x, self.r, self.z)
        self.start = controller.start(pair.t, pair.x, self.r)

    @property
    def nominal_memory_variables(self) -> list[Variable]:
        """Memory of the nominal controller, with prefixed names."""
        return [_add_nominal_prefix_to_variable(v) for v in self.controller.memory.variables]

    @property
    def nominal_signal_variables(self) -> list[Variable]:
        """Signals of the nominal controller, with prefixed names."""
        return [_add_nominal_prefix_to_variable(v) for v in self.controller.signals.variables]


def _add_nominal_prefix_to_variable(variable: Variable) -> Variable:
    return Variable(f"nominal_{variable.name}", variable.size, variable.unit)


def _solve_minimum_norm_system(matrix: Any, y: Any) -> Any:
    rows, columns = matrix.shape
    if matrix.is_constant():
        return ca.DM(np.linalg.pinv(np.asarray(ca.DM(matrix).full()))) @ y
    if rows == columns:
        return ca.solve(matrix, y)
    return matrix.T @ ca.solve(matrix @ matrix.T, y)
