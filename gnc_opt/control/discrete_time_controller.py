"""Controller: a discrete-time control law as a CasADi function, with memory, schedule and design report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import StrictAttributes, read_display_name, read_positive_number
from gnc_opt.array_types import Array
from gnc_opt.control.design_report import DesignReport
from gnc_opt.errors import ArgumentError
from gnc_opt.model.model_variables import Layout, read_state_vector
from gnc_opt.numerical_tolerances import SAME_TIME

Schedule: TypeAlias = Callable[[Array, float], Array]
"""``schedule(times, dt)`` returns signals (n_signals, n_times) for steps of dt (s) from times (s)."""


@dataclass(frozen=True, eq=False)
class CodegenLaw:
    """Control law for C export: elementary operations and at most one call of a solver.

    ``solver`` is an `gnc_opt.control.active_set_qp_c_code.QpCode`; the call has the name of its C function.
    """

    controller: Controller
    solver: Any = None


_INPUTS, _OUTPUTS = ["t", "x", "r", "z"], ["u", "z_next"]


@dataclass(frozen=True, eq=False)
class Controller(StrictAttributes):
    """A discrete-time control law ``(t, x, r, z) -> (u, z_next)``.

    A CasADi function without side effects of the time t, the measured state x, the row r of the schedule (reference,
    feedforward, gains) and the memory z. Returns the command u (zero-order hold) and the next memory.

    Attributes
    ----------
    name : str
    step : casadi.Function
        ``(t, x, r, z) -> (u, z_next)``, column vectors.
    start : casadi.Function
        ``(t, x, r) -> z``: initial memory, from the first measurement.
    states, commands, signals, memory : Layout
    schedule : Schedule
        See `Schedule`.
    explanation : DesignReport
    dt : float or None
        Control step of the design, s; ``None`` if the law applies to any step.
    alarms : tuple of str
        Memory entries that become nonzero at the first step at which the law cannot meet its guarantees.
    span : tuple of two floats, optional
        Times (s) between which the schedule changes; it is constant after the second.
    without_dropout_handling : Controller, optional
        The same law without dropout handling, see `with_dropout_handling`.
    estimated : Layout, optional
        States that an estimator computes for the law, see `output_feedback`; ``states`` are then the measurements.
    codegen_law : CodegenLaw, optional
        Law for C export, if the law solves an optimisation problem at every step.
    unconstrained_law : casadi.Function, optional
        ``(t, x, r, z) -> (u, z_next, valid)`` of elementary operations; equals ``step`` where valid is 1.

    Examples
    --------
    >>> u, memory = regulator(0.0, [1.0, 1.0], dt=0.1)  # one control step
    >>> print(np.round(u, 3), regulator.states.names, regulator.commands.names, regulator.dt)
    [-2.554] ('q', 'v') ('a',) 0.1
    """

    name: str
    step: Any
    start: Any
    states: Layout
    commands: Layout
    signals: Layout
    memory: Layout
    schedule: Schedule
    explanation: DesignReport
    dt: float | None = None
    alarms: tuple[str, ...] = ()
    span: tuple[float, float] | None = None
    without_dropout_handling: Controller | None = field(default=None, repr=False)
    estimated: Layout | None = None
    codegen_law: CodegenLaw | None = field(default=None, repr=False)
    unconstrained_law: Any = field(default=None, repr=False)

    def __post_init__(self) -> None:
        read_display_name(self.name, "controller")
        sizes = (1, self.states.size, self.signals.size, self.memory.size)
        _check_casadi_function_shape(
            f"the law of '{self.name}'", self.step, sizes, (self.commands.size, self.memory.size)
        )
        _check_casadi_function_shape(
            f"the first memory of '{self.name}'", self.start, sizes[:3], (self.memory.size,)
        )
        for alarm in self.alarms:
            self.memory.slice(alarm)

    def __repr__(self) -> str:
        step = "any control step" if self.dt is None else f"control step {self.dt:g} s"
        inputs, commands = ", ".join(self.states.names), ", ".join(self.commands.names)
        return f"Controller({self.name!r}: from {inputs} to {commands}, {step})"

    @property
    def reference_layout(self) -> Layout:
        """Layout of the states that the law feeds back and that its reference contains."""
        return self.states if self.estimated is None else self.estimated

    def explain(self) -> DesignReport:
        """Return the design report: gains, poles or margins, bounds and control authority margins."""
        return self.explanation

    def schedule_row(self, t: float, dt: float | None = None) -> Array:
        """Return the row r (n_signals,) of the schedule for a control step that begins at t (s)."""
        return self.schedule(np.array([float(t)]), self.step_length(dt))[:, 0]

    def step_length(self, dt: float | None = None) -> float:
        """Return the length of a control step (s); raise `ArgumentError` if ``dt`` differs from the design's."""
        if dt is None:
            if self.dt is None:
                raise ArgumentError(f"controller '{self.name}' has no own control step: give dt, in s.")
            return self.dt
        dt = read_positive_number(dt, f"the control step of '{self.name}'")
        if self.dt is not None and not np.isclose(dt, self.dt, rtol=SAME_TIME):
            raise ArgumentError(
                f"controller '{self.name}' was designed for control steps of {self.dt:g} s, not {dt:g} s: "
                "design it again with this dt."
            )
        return dt

    def initial_memory(self, t: float, x: ArrayLike, dt: float | None = None) -> Array:
        """Return the initial memory (n_memory,) at time t (s) and measured state x (n_states,)."""
        state = read_state_vector(x, self.states.size, f"the state given to '{self.name}'", ArgumentError)
        return np.asarray(self.start(float(t), state, self.schedule_row(t, dt)).full()[:, 0])

    def __call__(
        self, t: float, x: ArrayLike, z: ArrayLike | None = None, dt: float | None = None
    ) -> tuple[Array, Array]:
        """Evaluate one step: return the command (n_commands,) and the next memory (n_memory,).

        Parameters
        ----------
        t : float
            Start of the step, s.
        x : array (n_states,)
            Measured state.
        z : array (n_memory,), optional
            Memory; default: the initial memory.
        dt : float, optional
            Length of the step, s; see `step_length`.
        """
        state = read_state_vector(x, self.states.size, f"the state given to '{self.name}'", ArgumentError)
        row = self.schedule_row(t, dt)
        if z is not None and np.size(z) != self.memory.size:
            raise ArgumentError(
                f"the memory given to '{self.name}' has {np.size(z)} entries, not {self.memory.size}: give the one "
                "that the step before returned."
            )
        memory = np.asarray(self.start(float(t), state, row).full()[:, 0]) if z is None else z
        u, after = self.step(float(t), state, row, memory)
        return np.asarray(u.full()[:, 0]), np.asarray(after.full()[:, 0])


def law_function(t: Any, x: Any, r: Any, z: Any, u: Any, z_next: Any, *valid: Any) -> Any:
    """Return the CasADi function of a control law from its symbols and expressions (SX or MX column vectors).

    Parameters
    ----------
    t, x, r, z : casadi SX or MX
        Symbols: time (1, 1), measured state (n_states, 1), row of the schedule (n_signals, 1), memory (n_memory, 1).
    u, z_next : casadi SX or MX
        Command (n_commands, 1) and next memory (n_memory, 1), expressions of the symbols.
    valid : casadi SX or MX, optional
        Expression of the symbols, see ``unconstrained_law`` of `Controller`.

    Examples
    --------
    >>> import casadi as ca
    >>> t, x, r, z = ca.SX.sym("t"), ca.SX.sym("x", 2), ca.SX.sym("r", 0), ca.SX.sym("z", 0)
    >>> step = law_function(t, x, r, z, -x[0] - 2 * x[1], z)
    >>> print(step(0.0, [1.0, 0.5], [], [])[0])
    -2
    """
    names = [*_OUTPUTS, *("valid" for _ in valid)]
    return ca.Function("law", [t, x, r, z], [u, z_next, *valid], _INPUTS, names)


def initial_state_function(t: Any, x: Any, r: Any, z: Any) -> Any:
    """Return the CasADi function of the initial memory, from the symbols of `law_function` and z (n_memory, 1).

    Parameters
    ----------
    t, x, r, z : casadi SX or MX

    Examples
    --------
    >>> import casadi as ca
    >>> t, x, r = ca.SX.sym("t"), ca.SX.sym("x", 2), ca.SX.sym("r", 0)
    >>> start = initial_state_function(t, x, r, 3 * x[0])
    >>> print(start(0.0, [1.0, 0.0], []))
    3
    """
    return ca.Function("start", [t, x, r], [z], _INPUTS[:3], ["z"])


def _check_casadi_function_shape(
    what: str, function: Any, inputs: tuple[int, ...], outputs: tuple[int, ...]
) -> None:
    rows_in = tuple(function.size1_in(i) for i in range(function.n_in()))
    rows_out = tuple(function.size1_out(i) for i in range(function.n_out()))
    if (rows_in, rows_out) != (inputs, outputs):
        raise ArgumentError(
            f"{what} takes {rows_in} rows and returns {rows_out}: its layouts require {inputs} and {outputs}."
        )
