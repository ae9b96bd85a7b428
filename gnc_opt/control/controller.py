"""Controller: a discrete-time law as one symbolic function, with its memory, its schedule and its reasons."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import read_label, read_positive
from gnc_opt.arrays import Array
from gnc_opt.control.design_report import DesignReport
from gnc_opt.errors import ArgumentError
from gnc_opt.model.variables import Layout, as_point
from gnc_opt.tolerances import SAME_TIME

Schedule: TypeAlias = Callable[[Array, float], Array]
"""``schedule(times, dt)`` returns signals (n_signals, n_times) for steps of dt (s) from times (s)."""


@dataclass(frozen=True, eq=False)
class FlightLaw:
    """A law for flight code: elementary operations and at most one call of a solver, named as its C function.

    Of ``solver``, see `gnc_opt.control.active_set_qp.ProgrammeCode`, the C, operations and stack are taken.
    """

    controller: Controller
    solver: Any = None


_INPUTS, _OUTPUTS = ["t", "x", "r", "z"], ["u", "z_next"]


@dataclass(frozen=True, eq=False)
class Controller:
    """A discrete-time control law ``(t, x, r, z) -> (u, z_next)``.

    A CasADi function without side effects of the time t, the measured state x, the row r of the schedule
    (reference, feedforward, gains) and the memory z. Returns the held command u and the next z.

    Attributes
    ----------
    name : str
    step : casadi.Function
        ``(t, x, r, z) -> (u, z_next)``, columns.
    start : casadi.Function
        ``(t, x, r) -> z``: the memory at the first step, from the first measurement.
    states, commands, signals, memory : Layout
    schedule : `Schedule`
        See `Schedule`.
    explanation : DesignReport
    dt : float or None
        Control step of the design, s; ``None``: any.
    alarms : tuple of str
        Entries of the memory, nonzero from the first step at which the law cannot meet its guarantees.
    span : tuple of two floats, optional
        Times (s) between which the schedule changes; it is constant after the second.
    unbridged : Controller, optional
        The same law without dropout handling, see `with_dropout_handling`.
    estimated : Layout, optional
        The states fed back if an estimator computes them, see `output_feedback`; ``states`` then are measurements.
    flight : FlightLaw, optional
        Form for flight code of a law that solves a problem at every step.
    easy : casadi.Function, optional
        ``(t, x, r, z) -> (u, z_next, enough)`` of elementary operations: equals ``step`` wherever enough is 1.

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
    unbridged: Controller | None = field(default=None, repr=False)
    estimated: Layout | None = None
    flight: FlightLaw | None = field(default=None, repr=False)
    easy: Any = field(default=None, repr=False)

    def __post_init__(self) -> None:
        read_label(self.name, "controller")
        sizes = (1, self.states.size, self.signals.size, self.memory.size)
        _check_function_shape(
            f"the law of '{self.name}'", self.step, sizes, (self.commands.size, self.memory.size)
        )
        _check_function_shape(
            f"the first memory of '{self.name}'", self.start, sizes[:3], (self.memory.size,)
        )
        for alarm in self.alarms:
            self.memory.slice(alarm)

    def __repr__(self) -> str:
        step = "any control step" if self.dt is None else f"control step {self.dt:g} s"
        inputs, commands = ", ".join(self.states.names), ", ".join(self.commands.names)
        return f"Controller({self.name!r}: from {inputs} to {commands}, {step})"

    @property
    def followed(self) -> Layout:
        """Names, sizes and units of the states that the law feeds back and its reference is of."""
        return self.states if self.estimated is None else self.estimated

    def explain(self) -> DesignReport:
        """Return the facts of the design: gains, poles or margins, bounds and reserves; print them to read them."""
        return self.explanation

    def signal(self, t: float, dt: float | None = None) -> Array:
        """Return the row r (n_signals,) of the schedule for a control step that begins at t (s)."""
        return self.schedule(np.array([float(t)]), self.step_length(dt))[:, 0]

    def step_length(self, dt: float | None = None) -> float:
        """Return the length of a control step (s); `ArgumentError` if the given one is not the design's."""
        if dt is None:
            if self.dt is None:
                raise ArgumentError(f"controller '{self.name}' fits any control step: give dt, in s.")
            return self.dt
        dt = read_positive(dt, f"the control step of '{self.name}'")
        if self.dt is not None and not np.isclose(dt, self.dt, rtol=SAME_TIME):
            raise ArgumentError(
                f"controller '{self.name}' was designed for control steps of {self.dt:g} s, not {dt:g} s: "
                "design it again with this dt."
            )
        return dt

    def initial_memory(self, t: float, x: ArrayLike, dt: float | None = None) -> Array:
        """Return the memory (n_memory,) at a first step at t (s) with the measured state x (n_states,)."""
        state = as_point(x, self.states.size, f"the state given to '{self.name}'", ArgumentError)
        return np.asarray(self.start(float(t), state, self.signal(t, dt)).full()[:, 0])

    def __call__(
        self, t: float, x: ArrayLike, z: ArrayLike | None = None, dt: float | None = None
    ) -> tuple[Array, Array]:
        """Evaluate one step: return the command (n_commands,) and the next memory (n_memory,).

        Parameters
        ----------
        t : float
            Beginning of the step, s.
        x : array (n_states,)
            Measured state.
        z : array (n_memory,), optional
            Memory; without it the step is the first.
        dt : float, optional
            Length of the step, s; see `step_length`.
        """
        state = as_point(x, self.states.size, f"the state given to '{self.name}'", ArgumentError)
        row = self.signal(t, dt)
        if z is not None and np.size(z) != self.memory.size:
            raise ArgumentError(
                f"the memory given to '{self.name}' has {np.size(z)} entries, not {self.memory.size}: give the one "
                "that the step before returned."
            )
        memory = np.asarray(self.start(float(t), state, row).full()[:, 0]) if z is None else z
        u, after = self.step(float(t), state, row, memory)
        return np.asarray(u.full()[:, 0]), np.asarray(after.full()[:, 0])


def law(t: Any, x: Any, r: Any, z: Any, u: Any, z_next: Any, *enough: Any) -> Any:
    """Return the CasADi function of a control law from its symbols and expressions (SX or MX columns).

    Parameters
    ----------
    t, x, r, z : casadi SX or MX
        Symbols: time (1, 1), measured state (n_states, 1), row of the schedule (n_signals, 1), memory (n_memory, 1).
    u, z_next : casadi SX or MX
        Expressions of them: the command (n_commands, 1) and the next memory (n_memory, 1).
    enough : casadi SX or MX, optional
        Expression of them, see ``easy`` of `Controller`.

    Examples
    --------
    >>> import casadi as ca
    >>> t, x, r, z = ca.SX.sym("t"), ca.SX.sym("x", 2), ca.SX.sym("r", 0), ca.SX.sym("z", 0)
    >>> step = law(t, x, r, z, -x[0] - 2 * x[1], z)
    >>> print(step(0.0, [1.0, 0.5], [], [])[0])
    -2
    """
    names = [*_OUTPUTS, *("enough" for _ in enough)]
    return ca.Function("law", [t, x, r, z], [u, z_next, *enough], _INPUTS, names)


def initial_state_function(t: Any, x: Any, r: Any, z: Any) -> Any:
    """Return the CasADi function of the first memory from its symbols (as in `law`) and the expression z (n_memory, 1).

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


def _check_function_shape(
    what: str, function: Any, inputs: tuple[int, ...], outputs: tuple[int, ...]
) -> None:
    found = tuple(function.size1_in(i) for i in range(function.n_in()))
    found_out = tuple(function.size1_out(i) for i in range(function.n_out()))
    if (found, found_out) != (inputs, outputs):
        raise ArgumentError(
            f"{what} takes {found} rows and returns {found_out}: its layouts ask for {inputs} and {outputs}."
        )
