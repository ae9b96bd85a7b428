"""A controller with a plant that is any Python object: another simulator, or hardware behind an interface.

Slower than a `ClosedLoop`, and without its actuators, sensors, events and campaigns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import expect, read_numbers, read_positive
from gnc_opt.arrays import Array
from gnc_opt.control.controller import Controller
from gnc_opt.errors import ArgumentError
from gnc_opt.tolerances import STEP_SLACK


@runtime_checkable
class Plant(Protocol):
    """What `simulate_external_plant` asks of a plant, in turns: measure, step, measure, step."""

    def measure(self, t: float) -> ArrayLike:
        """Return the controller's measurements at t (s), (n_states,) in its order; NaN for lost samples."""

    def step(self, t: float, u: Array, dt: float) -> None:
        """Go on from t (s) by dt (s) under the held command u (n_commands,)."""


@dataclass(frozen=True, eq=False)
class ExternalPlantRun:
    """A run of a user-defined plant.

    Attributes
    ----------
    times : array (n + 1,)
        Beginnings of the control steps and the end, s.
    measured : array (n_states, n + 1)
        Measurements of the plant at these times.
    commands : array (n_commands, n)
        Held over the steps.
    memory : array (n_memory, n)
    alarms : tuple of str
        Of the controller, after each step and at the end.

    Examples
    --------
    >>> flight = ExternalPlantRun(np.array([0.0, 0.1]), np.ones((2, 2)), np.zeros((1, 1)), np.zeros((0, 1)), ())
    >>> print(flight.measured.shape)
    (2, 2)
    """

    times: Array
    measured: Array
    commands: Array
    memory: Array
    alarms: tuple[str, ...]


def simulate_external_plant(
    controller: Controller, plant: Plant, *, tf: float, t0: float = 0.0, dt: float | None = None
) -> ExternalPlantRun:
    """Return the run of a plant that is a Python object under a controller.

    Parameters
    ----------
    controller : Controller
        Also one of measurements, from `output_feedback`.
    plant : Plant
        Has ``measure(t)`` and ``step(t, u, dt)``; it stands where the flight begins.
    tf, t0 : float
        Last and first time, s; whole control steps apart.
    dt : float, optional
        Control step, s; default the controller's.

    Raises
    ------
    ArgumentError
        A method is missing, sizes do not fit, or times are no whole steps apart.

    Examples
    --------
    >>> class Sled:
    ...     x = np.array([1.0, 0.0])
    ...     def measure(self, t):
    ...         return self.x
    ...     def step(self, t, u, dt):
    ...         q, v = self.x
    ...         self.x = np.array([q + dt * v + dt**2 / 2 * u[0], v + dt * u[0]])
    >>> flight = simulate_external_plant(regulator, Sled(), tf=8.0)
    >>> print(np.round(flight.measured[:, -1], 3), flight.alarms)
    [-0.002  0.001] ()
    """
    expect(
        controller,
        Controller,
        "what simulate_external_plant() flies with",
        "give what a design function returned",
    )
    if not isinstance(plant, Plant):
        raise ArgumentError(
            f"a plant of type '{type(plant).__name__}' cannot be flown: "
            "give it the methods measure(t) and step(t, u, dt)."
        )
    dt = controller.step_length(dt)
    count = round(read_positive(tf - t0, "the duration of simulate_external_plant()") / dt)
    if count < 1 or abs(count * dt - (tf - t0)) > STEP_SLACK * dt:
        raise ArgumentError(f"{t0:g} to {tf:g} s are no whole number of control steps of {dt:g} s.")
    times: Array = t0 + dt * np.arange(count + 1.0)
    measured = np.empty((controller.states.size, count + 1))
    commands = np.empty((controller.commands.size, count))
    memory = np.empty((controller.memory.size, count))
    z = None
    for k, t in enumerate(times):
        measured[:, k] = _measured(controller, plant, float(t))
        if k == count:
            break
        commands[:, k], z = controller(float(t), measured[:, k], z, dt)
        memory[:, k] = z
        plant.step(float(t), commands[:, k].copy(), dt)
    raised = tuple(a for a in controller.alarms if np.any(memory[controller.memory.slice(a), -1] != 0))
    return ExternalPlantRun(times, measured, commands, memory, raised)


def _measured(controller: Controller, plant: Plant, t: float) -> Array:
    told = read_numbers(plant.measure(t), f"what the plant of '{controller.name}' measures")
    if told.size != controller.states.size:
        raise ArgumentError(
            f"the plant measures {told.size} numbers, and '{controller.name}' feeds back {controller.states.size}: "
            f"return {', '.join(controller.states.labels)}."
        )
    return told.ravel()
