"""Event: state reset or end of a run at a zero crossing of an expression.

A mode of a hybrid plant is a state with rate 0 that resets change; ``where`` restricts an event to modes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.argument_checks import StrictAttributes, read_display_name, require_distinct_names, require_type
from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError, quote_value, suggest_similar_name
from gnc_opt.model.model_variables import Layout, Variable, convert_to_sx_column, find_unknown_symbols
from gnc_opt.model.symbolic_dynamics_model import Model


def read_plant_expression(
    value: Any, what: str, plant: Model, size: int = 1, *, controls: bool = False
) -> Any:
    """Return an SX expression (size, 1) of the plant's time, states and parameters, optionally of its controls."""
    expression = convert_to_sx_column(value, what, size, ArgumentError)
    t, x, u, p = plant.symbolic_arguments()
    unknown = find_unknown_symbols(expression, [t, x, u, p] if controls else [t, x, p])
    if unknown:
        kinds = [plant.states, *([plant.controls] if controls else []), plant.parameters]
        allowed = "state, control or parameter" if controls else "state or parameter"
        raise ArgumentError(
            f"{what} uses '{unknown[0]}', which is no {allowed} of the plant '{plant.name}': "
            f"{suggest_similar_name(unknown[0], [name for kind in kinds for name in kind.names])}"
        )
    return expression


EVENTS_PER_STEP_MAX = 20
"""Largest number of events in a control step; more are treated as a Zeno sequence."""

_SIGNS = {"falling": (1.0,), "rising": (-1.0,), "either": (1.0, -1.0)}


@dataclass(frozen=True, eq=False)
class Event:
    """Zero crossing of an expression of the plant's states, with its effect.

    Parameters
    ----------
    name : str
    expression : casadi.SX
        Function of the plant's symbols of time, states and parameters, (1, 1). Its slope at the zero should not vanish.
    direction : {"falling", "rising", "either"}
        Direction of the crossing.
    reset : mapping, optional
        New state values by symbol or name, ``{v: -0.8 * v}``, as functions of the values before. Default: the event
        ends the run; an empty mapping only records the event.
    where : casadi.SX, optional
        Condition on the state at the crossing, such as ``stage < 1.5``.
    failure : bool
        Whether a run that this event ends has failed.

    Raises
    ------
    ArgumentError
        An invalid name or direction, or a failure that does not end the run.

    Examples
    --------
    >>> ball = go.Model("ball")
    >>> h, w = ball.state("h", unit="m"), ball.state("w", unit="m/s")
    >>> g = ball.control("g", unit="m/s^2")
    >>> ball.ode({h: w, w: g - 10.0})
    >>> bounce = Event("bounce", h, "falling", reset={w: -0.5 * w})
    >>> free = go.feedforward(go.Reference.constant(ball, [1.0, 0.0], [0.0]))
    >>> flown = go.ClosedLoop(ball, free, events=[bounce], dt=0.1).simulate([5.0, 0.0], tf=1.5)
    >>> print(flown.events[0].name, f"{flown.events[0].time:.6f}", np.round(flown.events[0].after, 6))
    bounce 1.000000 [0. 5.]
    """

    name: str
    expression: Any
    direction: str = "either"
    reset: Mapping[Any, Any] | None = None
    where: Any = None
    failure: bool = False

    def __post_init__(self) -> None:
        read_display_name(self.name, "event")
        if self.direction not in _SIGNS:
            raise ArgumentError(
                f"the direction of event '{self.name}' is {quote_value(self.direction)}: give one of {list(_SIGNS)}."
            )
        if self.reset is not None:
            remedy = "write reset={v: -v}, states with their new values"
            require_type(self.reset, Mapping, f"the reset of event '{self.name}'", remedy)
        require_type(self.failure, bool, f"failure of event '{self.name}'", "write True or False")
        if self.failure and not self.ends_run:
            raise ArgumentError(
                f"event '{self.name}' is a failure and does not end the run: leave out reset= or failure=."
            )

    @property
    def ends_run(self) -> bool:
        """Whether the event ends the run."""
        return self.reset is None


@dataclass(frozen=True, eq=False)
class EventOccurrence(StrictAttributes):
    """Event that occurred in a run.

    Attributes
    ----------
    name : str
    time : float
        s.
    before, after : array (n_states,)
        States of the plant before and after the reset.

    Examples
    --------
    >>> wall = go.ClosedLoop(cart, regulator, events=[Event("half way", q - 0.5, "falling", reset={})])
    >>> (passed,) = wall.simulate([1.0, 0.0], tf=8.0).events
    >>> print(passed.name, f"{passed.before[0]:.6f}")
    half way 0.500000
    """

    name: str
    time: float
    before: Array
    after: Array

    def __str__(self) -> str:
        return f"{self.name} at {self.time:.6g} s"


def read_event_occurrences(
    event_log: Mapping[str, Array], steps: int, names: Sequence[str], n_states: int
) -> list[EventOccurrence]:
    """Return the event occurrences in the logs of the first steps of a segment."""
    shape = (EVENTS_PER_STEP_MAX, n_states)
    return [
        EventOccurrence(
            names[int(event_log["codes"][k, step]) - 1],
            float(event_log["times"][k, step]),
            event_log["before"][:, step].reshape(shape)[k].copy(),  # views would keep the logs in memory
            event_log["after"][:, step].reshape(shape)[k].copy(),
        )
        for step in np.flatnonzero(event_log["number"][0, :steps])
        for k in range(int(min(event_log["number"][0, step], EVENTS_PER_STEP_MAX)))
    ]


@dataclass(frozen=True, eq=False)
class Events:
    """Events of a loop as CasADi functions of its plant."""

    declared: tuple[Event, ...]
    owners: tuple[int, ...]
    rows: Any
    effects: Any

    def __len__(self) -> int:
        return len(self.declared)

    def detect_undefined_events(self, t: Any, x: Any, p: Any, y: Any) -> Any:
        """Return which events (n_events, 1) have a row y of NaN at (t, x) while they are active; SX."""
        holds, _ = self.effects(t, x, p)
        flags = []
        for j in range(len(self)):
            blind = ca.logic_and(ca.logic_not(_is_not_nan_expression(y[self.owners.index(j)])), holds[j] != 0)
            flags.append(ca.logic_or(blind, ca.logic_not(_is_not_nan_expression(holds[j]))))
        return ca.vertcat(*flags)

    @property
    def layout(self) -> Layout:
        """Names of the events."""
        return Layout("event", tuple(Variable(e.name) for e in self.declared), "the closed loop")

    @classmethod
    def read_event_declarations(cls, plant: Model, declared: tuple[Event, ...]) -> Events:
        """Return the events of a plant; raise `ArgumentError` or `ModelError` for invalid ones."""
        require_distinct_names([event.name for event in declared], "events of the closed loop")
        if not declared:
            return cls((), (), None, None)
        t, x, _, p = plant.symbolic_arguments()
        rate = ca.SX.sym("dx_dt", plant.states.size)
        signed = [
            (sign * _read_zero_crossing_condition(event, plant), owner)
            for owner, event in enumerate(declared)
            for sign in _SIGNS[event.direction]
        ]
        y = ca.vertcat(*[row for row, _ in signed])
        slope = ca.jtimes(y, ca.vertcat(t, x), ca.vertcat(1, rate))
        conditions = [
            1.0 if e.where is None else _read_event_expression(e, e.where, "the condition", plant)
            for e in declared
        ]
        after = [_build_states_after_event(event, plant) for event in declared]
        return cls(
            declared,
            tuple(owner for _, owner in signed),
            ca.Function("rows", [t, x, rate, p], [y, ca.densify(slope)]),
            ca.Function("effects", [t, x, p], [ca.vertcat(*conditions), ca.horzcat(*after)]),
        )


def _is_not_nan_expression(value: Any) -> Any:
    """Return whether a value is not NaN; "x == x" is simplified to true for symbols."""
    return ca.fabs(value) <= ca.inf


def _read_zero_crossing_condition(event: Event, plant: Model) -> Any:
    """Return the expression of an event; raise an error if it cannot have a zero crossing."""
    condition, what = (
        _read_event_expression(event, event.expression, "the expression", plant),
        "the expression of event",
    )
    t, x, _, _ = plant.symbolic_arguments()
    if not ca.depends_on(condition, ca.vertcat(t, x)):
        raise ArgumentError(
            f"{what} '{event.name}' depends neither on a state nor on the time, and never passes through zero: "
            "write a function of a state, for example the altitude."
        )
    if ca.jacobian(condition, ca.vertcat(t, x)).is_zero():
        raise ArgumentError(
            f"{what} '{event.name}' is discontinuous at zero: write h - 0.5 with a direction, not h < 0.5."
        )
    return condition


def _read_event_expression(event: Event, value: Any, what: str, plant: Model, size: int = 1) -> Any:
    return read_plant_expression(value, f"{what} of event '{event.name}'", plant, size)


def _build_states_after_event(event: Event, plant: Model) -> Any:
    new = {name: plant.symbol(name) for name in plant.states.names}
    for key, value in (event.reset or {}).items():
        name = (
            key if isinstance(key, str) else getattr(getattr(key, "variable", None), "name", quote_value(key))
        )
        if name not in plant.states or not (isinstance(key, str) or key is plant.symbol(name)):
            raise ArgumentError(
                f"event '{event.name}' resets '{name}', which is no state of the plant '{plant.name}': "
                f"{suggest_similar_name(name, plant.states.names)}"
            )
        new[name] = _read_event_expression(event, value, f"the new '{name}'", plant, plant.states[name].size)
    return ca.vertcat(*new.values())
