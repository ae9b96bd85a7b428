"""Statement of an optimal control problem: its data and derived properties; `Problem` adds the declarations."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from gnc_opt.argument_checks import StrictAttributes
from gnc_opt.array_types import Array
from gnc_opt.errors import ProblemError, unknown_name_error
from gnc_opt.model.model_variables import Layout, Symbol
from gnc_opt.planning.problem.bounds import Interval, stack_intervals
from gnc_opt.planning.problem.constraints import Constraint
from gnc_opt.planning.problem.phase import Phase

S = TypeVar("S", bound="ProblemData")
T = TypeVar("T")


class ProblemData(StrictAttributes):
    """Phases, cost, boundary constraints and free parameters.

    Attributes
    ----------
    sense : float
        1 to minimise the cost, -1 to maximise it.
    stated_cost_unit, stated_time_unit : str
        Units given by the user; empty if no unit of the cost was given.
    parameter_bounds, parameter_guess : dict
        Bounds and guesses of the free parameters, by name.
    builds : dict
        Cache of objects built from the declarations, shared by variations with other numbers.
    """

    __slots__ = (
        "_parameters",
        "builds",
        "constraints",
        "cost",
        "name",
        "parameter_bounds",
        "parameter_guess",
        "phases",
        "sense",
        "stated_cost_unit",
        "stated_time_unit",
    )

    def __init__(self, name: str) -> None:
        self.name = name
        self.phases: dict[str, Phase] = {}
        self.constraints: dict[str, Constraint] = {}
        self.cost: Any = None
        self.sense = 1.0
        self.stated_cost_unit, self.stated_time_unit = "", "s"
        self._parameters: dict[str, Symbol] = {}
        self.parameter_bounds: dict[str, Interval] = {}
        self.parameter_guess: dict[str, Array] = {}
        self.builds: dict[Any, Any] = {}

    @property
    def parameters(self) -> Layout:
        """Names, sizes and units of the free parameters."""
        return Layout(
            "parameter", tuple(s.variable for s in self._parameters.values()), f"problem '{self.name}'"
        )

    @property
    def cost_unit(self) -> str:
        """Unit given for the cost; else that of the times, end states or parameters whose sum it is; else ""."""
        if self.stated_cost_unit or self.cost is None:
            return self.stated_cost_unit
        symbols, units = [self.parameter_symbols()], list(self.parameters.units)
        for phase in self.phases.values():
            symbols += [
                phase.end_states("initial"),
                phase.end_states("final"),
                phase.initial_time,
                phase.final_time,
            ]
            units += [*phase.model.states.units, *phase.model.states.units, *2 * [self.stated_time_unit]]
            symbols.append(phase.integral_symbols())
            units += [""] * phase.integral_symbols().shape[0]
        slopes = ca.jacobian(self.cost, ca.vertcat(*symbols))
        if not slopes.is_constant():
            return ""
        weights = np.abs(ca.DM(slopes).full()[0])
        counted = {unit for unit, weight in zip(units, weights, strict=True) if weight}
        return counted.pop() if len(counted) == 1 and np.all((weights == 0) | (weights == 1)) else ""

    @property
    def time_unit(self) -> str:
        """Unit of time: the given unit of a cost that is a (multiple of a) final time or duration, else as stated."""
        for phase in self.phases.values() if self.stated_cost_unit else ():
            factor = ca.jacobian(self.cost, phase.final_time)
            for t in (
                (phase.final_time, phase.final_time - phase.initial_time) if factor.is_constant() else ()
            ):
                remainder = ca.jacobian(self.cost - factor * t, ca.vertcat(*ca.symvar(self.cost)))
                if float(factor) and remainder.is_zero():
                    share = f"× {abs(float(factor)):.4g} " if abs(float(factor)) != 1 else ""
                    return share + self.stated_cost_unit
        return self.stated_time_unit

    def path_units(self) -> dict[str, str]:
        """Return the units of the path constraints of all phases by label; "" for the lengths of directions."""
        units = {
            label: c.unit
            for phase in self.phases.values()
            for c in phase.paths.values()
            for label in c.labels
        }
        return defaultdict(str, units)

    def add_parameter(self, symbol: Symbol, bounds: Interval, guess: Array) -> None:
        """Add a free parameter."""
        name = symbol.variable.name
        self._parameters[name] = symbol
        self.parameter_bounds[name] = bounds
        self.parameter_guess[name] = guess

    def free_parameter_symbols(self) -> tuple[Symbol, ...]:
        """Return the symbols of the free parameters."""
        return tuple(self._parameters.values())

    def parameter_symbols(self) -> Any:
        """Stacked SX symbols of the free parameters."""
        return ca.vertcat(*self._parameters.values()) if self._parameters else ca.SX(0, 1)

    def get_parameter_guess(self) -> Array:
        """Return the guesses of the stacked free parameters."""
        return np.concatenate([np.zeros(0), *self.parameter_guess.values()])

    def get_parameter_bounds(self) -> Interval:
        """Bounds of the stacked free parameters."""
        return stack_intervals(self.parameter_bounds.values())

    def get_phase(self, phase: Phase | str | None = None) -> Phase:
        """Return a phase by name; ``None`` for the only phase."""
        if isinstance(phase, Phase):
            own_phase = self.phases.get(phase.name)
            if own_phase is None or own_phase.initial_time is not phase.initial_time:
                raise ProblemError(
                    f"{phase.label} is not a phase of problem '{self.name}': use one of its own."
                )
            return own_phase
        if phase is None:
            if len(self.phases) != 1:
                raise ProblemError(
                    f"problem '{self.name}' has {len(self.phases)} phases: name one of {list(self.phases)}."
                )
            return next(iter(self.phases.values()))
        if not isinstance(phase, str) or phase not in self.phases:
            raise unknown_name_error("phase", phase, f"problem '{self.name}'", self.phases)
        return self.phases[phase]

    def substitute_parameters(self, phase: Phase, expression: Any) -> Any:
        """Replace model parameters that the problem optimises by the symbols of the problem."""
        for name, symbol in self._parameters.items():
            if name in phase.model.parameters:
                expression = ca.substitute(expression, phase.model.symbol(name), symbol)
        return expression

    def constraint_expression(self) -> Any:
        """Stacked SX expression of all boundary constraints."""
        rows = [c.expression for c in self.constraints.values()]
        return ca.vertcat(*rows) if rows else ca.SX(0, 1)

    def get_boundary_constraint_bounds(self) -> Interval:
        """Bounds of all boundary constraint rows."""
        return stack_intervals(c.interval for c in self.constraints.values())

    def constraint_labels(self) -> tuple[str, ...]:
        """Names of the boundary constraint rows."""
        return tuple(label for c in self.constraints.values() for label in c.labels)

    def clone(self: S) -> S:
        """Return a mutable copy with its own numbers and shared symbols and cache."""
        raise NotImplementedError

    def memoize(self, key: Any, build: Callable[[], T]) -> T:
        """Return a cached object of this problem, shared with variations that have other numbers."""
        if key not in self.builds:
            self.builds[key] = build()
        built: T = self.builds[key]
        return built

    def has_same_expressions_as(self, other: ProblemData) -> bool:
        """Return whether another problem is a variation of this one or of its reformulation, with other numbers."""
        return other.builds is self.builds or _can_reuse_compiled_functions(self.builds, other.builds)


def _can_reuse_compiled_functions(builds: dict[Any, Any], others: dict[Any, Any]) -> bool:
    nested = (value for value in builds.values() if isinstance(value, dict))
    return any(own is others or _can_reuse_compiled_functions(own, others) for own in nested)
