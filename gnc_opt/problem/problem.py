"""Problem: one or more phases, their cost, constraints, linkages and free parameters."""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.errors import ProblemError, unknown_name
from gnc_opt.model.layout import Array, Layout, Variable, as_vector
from gnc_opt.model.model import Model
from gnc_opt.model.symbol import Symbol, as_expression, foreign_symbols
from gnc_opt.problem.interval import Interval, free, read_interval
from gnc_opt.problem.phase import Constraint, GuessValue, Phase, make_constraint


class Problem:
    """An optimal control problem in Bolza form over one or more phases.

    Parameters
    ----------
    name : str
        For messages and reports.

    Notes
    -----
    The cost is any expression in end-point symbols (``leg.final_time``, ``leg.final_state("m")``), integrals
    (``leg.integral(a**2)``) and parameters. Costates follow Pontryagin's *minimum* principle for the
    minimised functional; a maximised J is minimised as -J.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.phases: dict[str, Phase] = {}
        self.constraints: dict[str, Constraint] = {}
        self.cost: Any = None
        self.sense = 1.0
        self._parameters: dict[str, Symbol] = {}
        self.parameter_bounds: dict[str, Interval] = {}
        self.parameter_guess: dict[str, Array] = {}
        self.builds: dict[Any, Any] = {}

    def __repr__(self) -> str:
        return f"Problem({self.name!r}: {', '.join(map(repr, self.phases.values()))})"

    # --- declarations -----------------------------------------------------------------------------

    def phase(self, name: str, model: Model) -> Phase:
        """Add a phase that follows ``model`` and return it.

        Raises
        ------
        ProblemError
            The name is taken or not an identifier, or the model has missing dynamics.
        """
        if not isinstance(name, str) or not name.isidentifier():
            raise ProblemError(f"{name!r} is not a phase name: use letters, digits and underscores.")
        if name in self.phases:
            raise ProblemError(f"problem '{self.name}' has two phases '{name}': rename one.")
        model.derivative()
        model.mark_in_use(f"problem '{self.name}'")
        self.phases[name] = Phase(name, model, self.name, self._changed)
        self._changed()
        return self.phases[name]

    def parameter(
        self,
        name: str,
        size: int = 1,
        *,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
        guess: ArrayLike | None = None,
        unit: str = "",
    ) -> Symbol:
        """Declare a static parameter to optimise and return its symbol.

        A model parameter of the same name becomes this free parameter, in every phase.

        Parameters
        ----------
        name : str
            An identifier, unique among the problem's parameters.
        size : int
            Number of components.
        lower, upper : float or array (size,), optional
            Bounds; left out, there is none.
        guess : float or array (size,), optional
            Starting value; default: the middle of the bounds.
        unit : str
            For printing.

        Raises
        ------
        ProblemError
            Name taken or no identifier, size < 1, crossed bounds.
        """
        if name in self._parameters:
            raise ProblemError(f"problem '{self.name}' has two parameters '{name}': rename one.")
        what = f"parameter '{name}' of problem '{self.name}'"
        if not name.isidentifier() or size < 1:
            raise ProblemError(f"{what}: give an identifier and a size >= 1.")
        bounds = read_interval(
            (None if lower is None else np.asarray(lower), None if upper is None else np.asarray(upper)), size, what
        )
        start = bounds.middle if guess is None else as_vector(guess, size, f"guess of {what}")
        self._parameters[name] = Symbol(Variable(name, size, unit))
        self.parameter_bounds[name] = bounds
        self.parameter_guess[name] = start
        self._changed()
        return self._parameters[name]

    def constrain(
        self, name: str, expression: Any, *, lower: Any = None, upper: Any = None, equals: Any = None
    ) -> None:
        """Add a boundary constraint on end-point states, times, integrals and parameters.

        Parameters
        ----------
        name : str
            Unique in the problem; appears in reports and names the multiplier.
        expression : casadi.SX or list
            In end-point symbols (``leg.final_state("m")``), times, integrals and parameters.
        lower, upper : float or array, optional
            At least one of them, unless ``equals`` is given.
        equals : float or array, optional
            For an equality.

        Raises
        ------
        ProblemError
            Name taken, no limit or contradictory ones, or a symbol that varies along a phase.
        """
        if name in self.constraints:
            raise ProblemError(f"problem '{self.name}' has two constraints '{name}': rename one.")
        what = f"constraint '{name}' of problem '{self.name}'"
        self.constraints[name] = make_constraint(name, expression, lower, upper, equals, what)
        self._check_end_expression(self.constraints[name].expression, what)
        self._changed()

    def link(
        self,
        first: Phase | str,
        second: Phase | str,
        *,
        states: Iterable[str] | None = None,
        time: bool = True,
        jump: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        """Continue ``second`` where ``first`` ends.

        Parameters
        ----------
        first, second : Phase or str
        states : iterable of str, optional
            The states to hand over; default: all that both models have.
        time : bool
            Whether the second phase starts when the first one ends.
        jump : mapping, optional
            Known jumps by state: x_second(start) - x_first(end), e.g. a dropped stage's mass.
        """
        a, b = self.get_phase(first), self.get_phase(second)
        shared = [n for n in a.model.states.names if n in b.model.states]
        names = shared if states is None else list(states)
        jumps = dict(jump or {})
        for name in [*names, *jumps]:
            for side in (a, b):
                side.model.states.slice(name)
        label = f"link_{a.name}_{b.name}"
        for name in dict.fromkeys([*names, *jumps]):
            gap = b.initial_state(name) - a.final_state(name)
            value = as_vector(jumps.get(name, 0.0), a.model.states[name].size, f"jump of '{name}'")
            self.constrain(f"{label}_{name}", gap, equals=value)
        if time:
            self.constrain(f"{label}_time", b.initial_time - a.final_time, equals=0.0)

    def minimize(self, cost: Any) -> None:
        """State the cost to minimise: an expression in end points, integrals and parameters."""
        self._set_cost(cost, 1.0)

    def maximize(self, payoff: Any) -> None:
        """State the payoff to maximise; costates belong to the minimised functional -payoff."""
        self._set_cost(payoff, -1.0)

    # --- variations: new numbers, same structure ----------------------------------------------------

    def with_initial(self, phase: str | None = None, /, **values: Any) -> Problem:
        """Return a copy with other initial values; ``phase`` may be left out when there is one."""
        twin = self._clone()
        twin.get_phase(phase).initial(**values)
        return twin

    def with_final(self, phase: str | None = None, /, **values: Any) -> Problem:
        """Return a copy with other final values."""
        twin = self._clone()
        twin.get_phase(phase).final(**values)
        return twin

    def with_bounds(self, phase: str | None = None, /, **ranges: Any) -> Problem:
        """Return a copy with other bounds of states or controls."""
        twin = self._clone()
        twin.get_phase(phase).bounds(**ranges)
        return twin

    def with_time(self, phase: str | None = None, /, **times: Any) -> Problem:
        """Return a copy with other times: ``with_time(initial=..., final=..., duration=...)``."""
        twin = self._clone()
        leg = twin.get_phase(phase)
        old = leg.numbers
        shared = self.builds
        given = {k: v for k, v in times.items() if k in ("initial", "final", "duration")}
        if set(times) - set(given):
            raise unknown_name("time", next(iter(set(times) - set(given))), leg.where, ("initial", "final", "duration"))
        leg.time(**given)
        keep = {f"{k}_time": getattr(old, f"{k}_time") for k in ("initial", "final") if k not in given}
        leg.numbers = replace(leg.numbers, **keep)
        twin.builds = shared
        return twin

    def with_guess(self, phase: str | None = None, /, time: ArrayLike | None = None, **values: GuessValue) -> Problem:
        """Return a copy with another guess; see ``Phase.guess``."""
        twin = self._clone()
        twin.get_phase(phase).guess(time, **values)
        return twin

    def with_scale(self, phase: str | None = None, /, **magnitudes: ArrayLike) -> Problem:
        """Return a copy with other scales; see ``Phase.scale``."""
        twin = self._clone()
        twin.get_phase(phase).scale(**magnitudes)
        return twin

    def with_arcs(self, phase: str | None = None, /, *, arcs: ArrayLike | None) -> Problem:
        """Return a copy whose controls are held on their bounds segment by segment; see ``Phase.hold``."""
        twin = self._clone()
        twin.get_phase(phase).hold(arcs)
        return twin

    def with_parameters(self, **values: ArrayLike) -> Problem:
        """Return a copy with other values of model parameters (in every model that has them)."""
        twin = self._clone()
        for name in values:
            if not any(name in leg.model.parameters for leg in twin.phases.values()):
                known = {n for leg in twin.phases.values() for n in leg.model.parameters.names}
                raise unknown_name("model parameter", name, f"problem '{self.name}'", sorted(known))
        for leg in twin.phases.values():
            own = {k: v for k, v in values.items() if k in leg.model.parameters}
            leg.model = leg.model.with_parameters(**own)
        return twin

    def check(self) -> None:
        """Raise `ProblemError` for what a solver could only stumble over; `solve` runs it too.

        Checks times, costs, boundary values against bounds, unused controls and parameters, foreign symbols,
        and evaluates every function and Jacobian along the guess, naming the state, phase and time of a NaN.
        """
        from gnc_opt.problem.check import check_problem

        check_problem(self)

    # --- what it is -------------------------------------------------------------------------------

    @property
    def parameters(self) -> Layout:
        """Names, sizes and units of the free parameters."""
        return Layout(
            "parameter", tuple(s.variable for s in self._parameters.values()), f"problem '{self.name}'"
        )

    def parameter_symbols(self) -> Any:
        """Stacked SX symbols of the free parameters."""
        return ca.vertcat(*self._parameters.values()) if self._parameters else ca.SX(0, 1)

    def parameter_interval(self) -> Interval:
        """Bounds of the stacked free parameters."""
        boxes = list(self.parameter_bounds.values())
        if not boxes:
            return free(0)
        return Interval(np.concatenate([b.lower for b in boxes]), np.concatenate([b.upper for b in boxes]))

    def get_phase(self, phase: Phase | str | None = None) -> Phase:
        """Return a phase by name; ``None`` is the only one there is."""
        if isinstance(phase, Phase):
            phase = phase.name
        if phase is None:
            if len(self.phases) != 1:
                raise ProblemError(
                    f"problem '{self.name}' has {len(self.phases)} phases: name one of {list(self.phases)}."
                )
            return next(iter(self.phases.values()))
        if phase not in self.phases:
            raise unknown_name("phase", phase, f"problem '{self.name}'", self.phases)
        return self.phases[phase]

    def bind(self, phase: Phase, expression: Any) -> Any:
        """Replace model parameters that the problem optimises by the problem's own symbols."""
        for name, symbol in self._parameters.items():
            if name in phase.model.parameters:
                expression = ca.substitute(expression, phase.model.symbol(name), symbol)
        return expression

    def constraint_expression(self) -> Any:
        """Stacked SX expression of all boundary constraints."""
        rows = [c.expression for c in self.constraints.values()]
        return ca.vertcat(*rows) if rows else ca.SX(0, 1)

    def constraint_interval(self) -> Interval:
        """Bounds of all boundary constraint rows."""
        boxes = [c.interval for c in self.constraints.values()]
        if not boxes:
            return free(0)
        return Interval(np.concatenate([b.lower for b in boxes]), np.concatenate([b.upper for b in boxes]))

    def constraint_labels(self) -> tuple[str, ...]:
        """Names of the boundary constraint rows."""
        return tuple(label for c in self.constraints.values() for label in c.labels)

    def end_symbols(self) -> list[Any]:
        """All symbols a cost or boundary constraint may use, phase by phase, then the parameters."""
        symbols: list[Any] = []
        for leg in self.phases.values():
            symbols += [leg.ends("initial"), leg.ends("final"), leg.initial_time, leg.final_time]
            symbols += [leg.integral_symbols(), leg.model.symbols("parameter")]
        return [*symbols, self.parameter_symbols()]

    def fingerprint(self) -> str:
        """Return a hash of the functions, names and numbers that define the problem (hex, 16 digits)."""
        digest = hashlib.sha256()
        for leg in self.phases.values():
            pieces = [leg.model.derivative(), leg.path_expression(), leg.integrand_expression()]
            digest.update(b"".join(map(_exact, pieces)))
            digest.update(str((leg.name, leg.model.states, leg.model.controls, leg.model.parameters)).encode())
            for vector in (leg.model.parameter_values, *_vectors(leg.numbers), *_vectors(leg.path_interval())):
                digest.update(vector.tobytes())
        digest.update(_exact(self.cost) + _exact(self.constraint_expression()) + str(self.sense).encode())
        for vector in (*_vectors(self.constraint_interval()), *_vectors(self.parameter_interval())):
            digest.update(vector.tobytes())
        return digest.hexdigest()[:16]

    # --- internals --------------------------------------------------------------------------------

    def _clone(self) -> Problem:
        twin = copy.copy(self)
        twin.phases = {name: leg.clone(twin._changed) for name, leg in self.phases.items()}
        twin.constraints = dict(self.constraints)
        twin._parameters = dict(self._parameters)
        twin.parameter_bounds = dict(self.parameter_bounds)
        twin.parameter_guess = dict(self.parameter_guess)
        return twin

    def _changed(self) -> None:
        self.builds = {}

    def _set_cost(self, cost: Any, sense: float) -> None:
        if self.cost is not None:
            raise ProblemError(f"problem '{self.name}' has two costs: keep one minimize() or maximize().")
        expression = as_expression(cost, f"cost of problem '{self.name}'", 1)
        self._check_end_expression(expression, f"cost of problem '{self.name}'")
        self.cost, self.sense = expression, sense
        self._changed()

    def _check_end_expression(self, expression: Any, what: str) -> None:
        foreign = foreign_symbols(expression, self.end_symbols())
        if not foreign:
            return
        name = foreign[0]
        for leg in self.phases.values():
            if not foreign_symbols(expression, [*self.end_symbols(), *leg.model.arguments()]):
                raise ProblemError(
                    f"{what} uses '{name}', which varies along phase '{leg.name}': use "
                    f"{leg.name}.final_state(...), {leg.name}.initial_state(...) or {leg.name}.integral(...)."
                )
        raise ProblemError(f"{what} uses '{name}', which belongs to no phase of this problem.")


def _vectors(box: Any) -> Iterable[Array]:
    """Yield every float vector of a dataclass of intervals, depth first."""
    for value in vars(box).values():
        if isinstance(value, Interval):
            yield from (value.lower, value.upper)
        elif isinstance(value, np.ndarray):
            yield value


def _exact(expression: Any) -> bytes:
    """Return an expression with every digit of its constants; printed, they would be rounded to six."""
    symbols = ca.vertcat(ca.SX(0, 1), *ca.symvar(expression))
    return bytes(ca.Function("exact", [symbols], [expression]).serialize(), "ascii")
