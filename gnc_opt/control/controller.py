"""Controller: a discrete-time law as one symbolic function, with its memory, its schedule and its reasons."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import read_label, read_positive
from gnc_opt.arrays import Array
from gnc_opt.control.c_export.c_writer import CNumbers
from gnc_opt.control.design_report import DesignReport
from gnc_opt.control.error_dynamics import sampled_system
from gnc_opt.errors import ArgumentError
from gnc_opt.model.variables import Layout, as_point
from gnc_opt.tolerances import SAME_TIME

Schedule: TypeAlias = Callable[[Array, float], Array]
"""``schedule(times, dt)`` returns the law's signals in advance, (n_signals, n_times), for control steps that
begin at ``times`` (n,) and last ``dt`` (s).
"""


class SolverCode(Protocol):
    """The C of the solver that a law calls once."""

    @property
    def operations(self) -> int:
        """Arithmetic operations and comparisons of a call, at most."""

    @property
    def stack(self) -> int:
        """Numbers on the stack of a call, at most."""

    def text(self, numbers: CNumbers) -> str:
        """Return tables and functions, behind ``schedule`` and ``row_of``."""


@dataclass(frozen=True, eq=False)
class FlightLaw:
    """A law with a solver inside as flight code has it.

    Attributes
    ----------
    controller : Controller
        Of elementary operations and, with a solver, one call, named as the C function.
    solver : SolverCode, optional
    """

    controller: Controller
    solver: SolverCode | None = None


_INPUTS, _OUTPUTS = ["t", "x", "r", "z"], ["u", "z_next"]


@dataclass(frozen=True, eq=False)
class Controller:
    """A discrete-time control law ``(t, x, r, z) -> (u, z_next)``.

    The law is a CasADi function without side effects, so it can be simulated, differentiated, mapped over a
    campaign and written as C. At a control step that begins at t it gets the measured state x, the row r of its
    schedule (reference, feedforward, gains: whatever is known beforehand) and its memory z; it returns the command u,
    held until the next step, and the memory of the next step.

    Attributes
    ----------
    name : str
    step : casadi.Function
        ``(t, x, r, z) -> (u, z_next)``, columns.
    start : casadi.Function
        ``(t, x, r) -> z``: the memory at the first step, from the first measurement. An integral surface, for
        example, begins at zero this way.
    states, commands, signals, memory : Layout
        Names, sizes and units of x, u, r and z.
    estimated : Layout, optional
        The states that the law feeds back if an estimator computes them from measurements, see
        `output_feedback`; ``states`` then are measurements.
    flight : FlightLaw, optional
        The form of the law in flight code, for a law that solves a problem at every step.
    easy : casadi.Function, optional
        ``(t, x, r, z) -> (u, z_next, enough)`` of elementary operations: the bits of ``step`` wherever enough is 1,
        for a law that solves a problem at some steps only.
    schedule : callable
        See `Schedule`.
    dt : float or None
        Length of a control step that the law was designed for, s; ``None``: any.
    alarms : tuple of str
        Entries of the memory that are 0 in normal operation and nonzero from the first step at which the law
        cannot meet its guarantees (a singular decoupling matrix, a failed QP, a NaN measurement).
    explanation : DesignReport
    span : tuple of two floats, optional
        Times (s) between which the schedule changes; it is constant after the second. None: unknown.
    unbridged : Controller, optional
        The same law without its provision for lost samples, see `with_dropout_handling`.

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
        _check_shape(f"the law of '{self.name}'", self.step, sizes, (self.commands.size, self.memory.size))
        _check_shape(f"the first memory of '{self.name}'", self.start, sizes[:3], (self.memory.size,))
        for alarm in self.alarms:
            self.memory.slice(alarm)

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
        """Return the length of a control step (s), the given one or the design's own.

        Raises
        ------
        ArgumentError
            The law was designed for another step, or for any and none is given.
        """
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

    def to_control(self, dt: float | None = None) -> Any:
        """Return the law as a sampled system of python-control, from the measured state to the command.

        Its state is the memory, whose first value is ``initial_memory(t, x)[:system.nstates]``; there is no provision
        for lost samples. ``system.linearize(z, x)`` is the linear system about a memory and a measurement.

        Parameters
        ----------
        dt : float, optional
            Length of the control step, s; see `step_length`.

        Returns
        -------
        control.NonlinearIOSystem

        Raises
        ------
        ArgumentError
            See `step_length`.
        GncOptError
            The extra ``control`` is not installed.
        """
        bare, length = self.unbridged or self, self.step_length(dt)

        def step(t: float, z: Array, x: Array) -> tuple[Array, Array]:
            return bare(t, x, z, length)

        return sampled_system(self.name, step, length, bare.memory, bare.states, bare.commands)


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
    """Return the CasADi function of the first memory from its symbols and the expression z.

    Parameters
    ----------
    t, x, r : casadi SX or MX
        Symbols as in `law`.
    z : casadi SX or MX
        Expression of them, (n_memory, 1).

    Examples
    --------
    >>> import casadi as ca
    >>> t, x, r = ca.SX.sym("t"), ca.SX.sym("x", 2), ca.SX.sym("r", 0)
    >>> start = initial_state_function(t, x, r, 3 * x[0])
    >>> print(start(0.0, [1.0, 0.0], []))
    3
    """
    return ca.Function("start", [t, x, r], [z], _INPUTS[:3], ["z"])


def _check_shape(what: str, function: Any, inputs: tuple[int, ...], outputs: tuple[int, ...]) -> None:
    found = tuple(function.size1_in(i) for i in range(function.n_in()))
    found_out = tuple(function.size1_out(i) for i in range(function.n_out()))
    if (found, found_out) != (inputs, outputs):
        raise ArgumentError(
            f"{what} takes {found} rows and returns {found_out}: its layouts ask for {inputs} and {outputs}."
        )
