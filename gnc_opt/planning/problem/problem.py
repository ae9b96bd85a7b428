"""Problem: optimal control problem with phases, cost, constraints, linkages and free parameters."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import (
    read_display_name,
    read_float_array,
    read_integer,
    read_optional_mapping,
    read_variable_name,
    require_type,
)
from gnc_opt.errors import ProblemError, unknown_name_error
from gnc_opt.model.model_variables import Symbol, Variable, convert_to_sx_column, read_vector
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.planning.problem.active_constraint_arcs import Junction, SmoothControl
from gnc_opt.planning.problem.bounds import Interval, read_lower_and_upper_limits, read_value_or_range
from gnc_opt.planning.problem.constraints import make_constraint
from gnc_opt.planning.problem.guess.guess_evaluation import GuessValue
from gnc_opt.planning.problem.guess.initial_guess import guess_end_states_from_constraint
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.phase_bounds_and_guess import read_duration
from gnc_opt.planning.problem.phase_linkage_and_division import build_linkage_constraints, divide_phase
from gnc_opt.planning.problem.problem_check import check_problem
from gnc_opt.planning.problem.problem_definition import ProblemData
from gnc_opt.planning.problem.problem_fingerprint import compute_problem_fingerprint
from gnc_opt.planning.problem.symbolic_expressions import (
    check_boundary_symbols,
    check_parameter_size,
    check_phase_symbols,
)
from gnc_opt.text_html_and_json_formatting import format_html_heading, format_html_table


class Problem(ProblemData):
    """An optimal control problem in Bolza form over one or more phases.

    Parameters
    ----------
    name : str
        Name in messages and reports.
    time_unit : str
        Unit of time in messages, figures and reports.

    Notes
    -----
    The cost is an expression of end-point symbols, integrals and parameters. Costates satisfy Pontryagin's *minimum*
    principle for the minimised functional; maximising J is minimising -J.

    Examples
    --------
    >>> hop = go.Problem("rest to rest with the least effort")
    >>> leg = hop.phase("leg", cart)
    >>> leg.time(0.0, 1.0)
    >>> leg.initial(q=0.0, v=0.0)
    >>> leg.final(q=1.0, v=0.0)
    >>> hop.minimize(leg.integral(cart.symbol("a") ** 2))
    >>> print(round(go.solve(hop).objective, 6))
    12.0
    """

    __slots__ = ("_frozen",)

    def __init__(self, name: str, *, time_unit: str = "s") -> None:
        super().__init__(require_type(name, str, "the name of a problem", 'write Problem("rest to rest")'))
        self.stated_time_unit = require_type(time_unit, str, "the unit of time", 'write time_unit="h"')
        self._frozen = False

    def __repr__(self) -> str:
        return f"Problem({self.name!r}: {', '.join(map(repr, self.phases.values()))})"

    def _repr_html_(self) -> str:
        """Return an HTML table with one row per phase, for notebooks."""
        rows = [
            (
                phase.name,
                phase.model.name,
                ", ".join(map(str, phase.model.states.variables)),
                ", ".join(map(str, phase.model.controls.variables)),
                ", ".join(phase.path_labels),
            )
            for phase in self.phases.values()
        ]
        titles = ("phase", "model", "states", "controls", "path constraints")
        cost = "maximised" if self.sense < 0 else "minimised"
        return format_html_heading(f"{self.name}, cost {cost}") + format_html_table(titles, rows)

    # --- declarations -----------------------------------------------------------------------------

    def phase(self, name: str, model: Model) -> Phase:
        """Add a phase with the given model and return it."""
        self.require_mutable()
        read_display_name(name, f"phase of problem '{self.name}'", ProblemError)
        if name in self.phases:
            raise ProblemError(f"problem '{self.name}' has two phases '{name}': rename one.")
        require_type(
            model, Model, f"the model of phase '{name}' of problem '{self.name}'", "write phase(name, model)"
        )
        for parameter in self.parameters.variables:
            check_parameter_size(parameter.name, parameter.size, model, self.name)
        model.state_derivative()
        model.forbid_further_declarations(f"problem '{self.name}'")
        self.phases[name] = Phase(name, model, self)
        self.clear_cache()
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
        """Declare a free (optimised) static parameter and return its symbol.

        A model parameter of the same name is replaced by this free parameter in every phase.

        Parameters
        ----------
        name : str
            An identifier, unique among the problem's parameters.
        size : int
            Number of components.
        lower, upper : float or array (size,), optional
            Bounds; default: none.
        guess : float or array (size,), optional
            Initial guess; default: the middle of the bounds.
        unit : str
            Unit, for printing.

        Raises
        ------
        ProblemError
            Name already declared or not an identifier, size < 1, crossed bounds.
        """
        self.require_mutable()
        read_variable_name(name, f"parameter of problem '{self.name}'", ProblemError)
        if name in self._parameters:
            raise ProblemError(f"problem '{self.name}' has two parameters '{name}': rename one.")
        what = f"parameter '{name}' of problem '{self.name}'"
        if isinstance(size, (tuple, list)):
            raise ProblemError(
                f"the size of {what} is {size}: write lower=..., upper=... for bounds, and an integer for its size."
            )
        size = read_integer(size, f"the size of {what}", 1, ProblemError)
        require_type(unit, str, f"the unit of {what}", 'write unit="m/s"')
        bounds = read_lower_and_upper_limits(lower, upper, size, what)
        start = bounds.midpoint if guess is None else read_vector(guess, size, f"the guess of {what}")
        if not np.all(np.isfinite(start)):
            raise ProblemError(f"the guess of {what} is {start}: give finite numbers.")
        for phase in self.phases.values():
            check_parameter_size(name, size, phase.model, self.name)
        self.add_parameter(Symbol(Variable(name, size, unit)), bounds, start)
        self.clear_cache()
        return self._parameters[name]

    def constrain(
        self, name: str, expression: Any = None, *, lower: Any = None, upper: Any = None, equals: Any = None
    ) -> None:
        """Add a boundary constraint on end-point states, times, integrals and parameters.

        Parameters
        ----------
        name : str
            Unique in the problem; used in reports and for the multiplier.
        expression : casadi.SX or list
            Expression of end-point symbols (``leg.final_state("m")``), times, integrals and parameters; or an
            inequality or equation, ``leg.final_state("m") >= 300.0``, without limits.
        lower, upper : float or array, optional
            At least one of them, unless ``equals`` is given.
        equals : float or array, optional
            Value of an equality constraint.

        Raises
        ------
        ProblemError
            Name already declared, missing or contradictory limits, or a symbol that varies along a phase.
        """
        self.require_mutable()
        read_display_name(name, f"constraint of problem '{self.name}'", ProblemError)
        what = f"constraint '{name}' of problem '{self.name}'"
        if name in self.constraints:
            raise ProblemError(f"problem '{self.name}' has two constraints '{name}': rename one.")
        constraint = make_constraint(name, expression, lower, upper, equals, what)
        check_boundary_symbols(self.phases.values(), self.parameter_symbols(), constraint.expression, what)
        self.constraints[name] = constraint
        guess_end_states_from_constraint(
            constraint, self.phases.values(), self.parameter_symbols(), self.parameter_guess
        )
        self.clear_cache()

    def link(
        self,
        first: Phase | str,
        second: Phase | str,
        *,
        states: Iterable[str] | None = None,
        time: bool = True,
        jump: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        """Link the start of ``second`` to the end of ``first``.

        Parameters
        ----------
        first, second : Phase or str
        states : iterable of str, optional
            Linked states; default: all states of both models, except polynomials (`Phase.polynomials`).
        time : bool
            Whether the second phase starts at the end of the first one.
        jump : mapping, optional
            Known jumps by state: x_second(start) - x_first(end), e.g. a dropped stage's mass.
        """
        phases = self.get_phase(first), self.get_phase(second)
        for name, expression, value in build_linkage_constraints(self.name, *phases, states, time, jump):
            self.constrain(name, expression, equals=value)

    def sequence(
        self,
        *phases: Phase | str,
        durations: Mapping[str, Any] | None = None,
        start: Any = 0.0,
        drops: Mapping[str, Mapping[str, ArrayLike]] | None = None,
    ) -> None:
        """Link phases in sequence, with states, times and mass drops.

        Parameters
        ----------
        *phases : Phase or str
            Phases in order, two or more.
        durations : mapping of str to float or tuple, optional
            Duration of each phase, s: a number or a range ``(lower, upper)``; default: free. Ranges with both ends
            improve the guess.
        start : float, tuple or None
            Initial time of the first phase, s, as in ``Phase.time``.
        drops : mapping of str to mapping, optional
            Amount > 0 dropped at the end of a phase, by state: ``{"boost": {"m": 1200.0}}``.

        Raises
        ------
        ProblemError
            Fewer than two phases, a repeated phase, or an unknown name.
        """
        chain = [self.get_phase(phase) for phase in phases]
        names = [phase.name for phase in chain]
        if len(set(names)) < max(2, len(names)):
            raise ProblemError(
                f"sequence() of problem '{self.name}' got {names}: give two phases or more, each once."
            )
        durations = read_optional_mapping(durations, "durations of sequence()", 'write {"ascent": 100.0}')
        drops = read_optional_mapping(drops, "drops of sequence()", 'write {"ascent": {"m": 1200.0}}')
        for by_phase, known in ((durations, names), (drops, names[:-1])):
            for name in by_phase:
                if name not in known:
                    raise unknown_name_error("phase", name, f"sequence() of problem '{self.name}'", known)
        spans = [read_duration(durations.get(phase.name), phase.label) for phase in chain]
        begin = read_value_or_range(start, 1, f"the start of sequence() of problem '{self.name}'")
        for phase, span in zip(chain, spans, strict=True):
            end = Interval(begin.lower + span.lower, begin.upper + span.upper)
            phase.time(
                initial=_convert_interval_to_time_argument(begin),
                final=_convert_interval_to_time_argument(end),
                duration=(span.lower[0], span.upper[0]),
            )
            begin = end
        for first, second in pairwise(chain):
            what = f"the drops after {first.label}"
            drop = require_type(drops.get(first.name, {}), Mapping, what, 'write {"m": 1200.0}')
            jump = {n: -read_float_array(value, f"{what}, '{n}',", ProblemError) for n, value in drop.items()}
            self.link(first, second, jump=jump)

    def divide(
        self, phase: Phase | str, *, times: ArrayLike | None = None, fractions: ArrayLike | None = None
    ) -> tuple[Phase, ...]:
        """Divide a phase into linked phases, for constraints during a time window.

        The parts are named ``leg``, ``leg_2``, ``leg_3``, ... and have the bounds and path constraints of the phase.
        The first part keeps the initial values, the last part gets the final values. Call it before ``integral``,
        ``guess``, and costs or constraints at the end of the phase.

        Parameters
        ----------
        phase : Phase or str
        times : array (n,), optional
            Division times, s.
        fractions : array (n,), optional
            Fractions of the duration, instead of times.

        Returns
        -------
        tuple of Phase
            The n + 1 parts.

        Raises
        ------
        ProblemError
            Times or fractions that do not increase or are outside the phase, or a call after other statements.
        """
        return divide_phase(self, self.get_phase(phase), times, fractions)

    def minimize(self, cost: Any, *, unit: str = "") -> None:
        """Set the cost to minimise: an expression of end points, integrals and parameters.

        The default ``unit`` is that of the times, end states or parameters whose sum is the cost.
        """
        self._set_cost_expression(cost, 1.0, unit)

    def maximize(self, payoff: Any, *, unit: str = "") -> None:
        """Set the payoff to maximise, with the unit as in `minimize`; costates belong to the minimised -payoff."""
        self._set_cost_expression(payoff, -1.0, unit)

    # --- variations: new numbers, same structure ----------------------------------------------------

    def with_initial(self, phase: str | None = None, /, **values: Any) -> Problem:
        """Return a copy with other initial values; ``phase`` is optional for a single phase."""
        variation = self.clone()
        variation.get_phase(phase).initial(**values)
        return variation

    def with_final(self, phase: str | None = None, /, **values: Any) -> Problem:
        """Return a copy with other final values."""
        variation = self.clone()
        variation.get_phase(phase).final(**values)
        return variation

    def with_bounds(self, phase: str | None = None, /, **ranges: Any) -> Problem:
        """Return a copy with other bounds of states or controls."""
        variation = self.clone()
        variation.get_phase(phase).bounds(**ranges)
        return variation

    def with_time(self, phase: str | None = None, /, **times: Any) -> Problem:
        """Return a copy with other times: ``with_time(initial=..., final=..., duration=...)``."""
        variation = self.clone()
        changed = variation.get_phase(phase)
        old = changed.numbers
        shared = self.builds
        given = {k: v for k, v in times.items() if k in ("initial", "final", "duration")}
        if set(times) - set(given):
            raise unknown_name_error(
                "time", next(iter(set(times) - set(given))), changed.label, ("initial", "final", "duration")
            )
        changed.time(**given)
        changed.numbers = replace(
            changed.numbers,
            initial_time=changed.numbers.initial_time if "initial" in given else old.initial_time,
            final_time=changed.numbers.final_time if "final" in given else old.final_time,
        )
        variation.builds = shared
        return variation

    def with_guess(
        self, phase: str | None = None, /, time: ArrayLike | None = None, **values: GuessValue
    ) -> Problem:
        """Return a copy with another guess; see ``Phase.guess``."""
        variation = self.clone()
        variation.get_phase(phase).guess(time, **values)
        return variation

    def with_parameter_guess(self, **values: ArrayLike) -> Problem:
        """Return a copy with other guesses of free parameters."""
        variation = self.clone()
        for name, value in values.items():
            if name not in self._parameters:
                raise unknown_name_error("parameter", name, f"problem '{self.name}'", self._parameters)
            size = self._parameters[name].variable.size
            variation.parameter_guess[name] = read_vector(value, size, f"the guess of parameter '{name}'")
        return variation

    def with_scale(self, phase: str | None = None, /, **magnitudes: ArrayLike) -> Problem:
        """Return a copy with other scales; see ``Phase.scale``."""
        variation = self.clone()
        variation.get_phase(phase).scale(**magnitudes)
        return variation

    def with_fixed_arcs(
        self,
        phase: str | None = None,
        /,
        *,
        arcs: ArrayLike | None,
        paths: ArrayLike | None = None,
        states: ArrayLike | None = None,
        smooth: tuple[SmoothControl, ...] = (),
        junctions: tuple[Junction, ...] = (),
    ) -> Problem:
        """Return a copy with prescribed arcs, segment by segment; see ``Phase.hold``."""
        variation = self.clone()
        variation.get_phase(phase).hold(arcs, paths=paths, states=states, smooth=smooth, junctions=junctions)
        return variation

    def with_parameters(self, **values: ArrayLike) -> Problem:
        """Return a copy with other values of model parameters, in all models that contain them."""
        variation = self.clone()
        for name in values:
            if not any(name in phase.model.parameters for phase in variation.phases.values()):
                known = {n for phase in variation.phases.values() for n in phase.model.parameters.names}
                raise unknown_name_error("model parameter", name, f"problem '{self.name}'", sorted(known))
        for phase in variation.phases.values():
            model_values = {k: v for k, v in values.items() if k in phase.model.parameters}
            phase.model = phase.model.with_parameters(**model_values)
        return variation

    def check(self) -> None:
        """Raise `ProblemError` for mistakes in the problem statement; `solve` calls it too.

        Checks times, costs, boundary values, unused controls and parameters and foreign symbols, and evaluates every
        function and Jacobian along the guess. Warns of constant costs, kinks, jumps, tables and norms, with a remedy.
        """
        check_problem(self)

    def frozen(self) -> Problem:
        """Return an immutable copy, as stored in solutions; it shares cached objects."""
        if self._frozen:
            return self
        frozen_copy = self.clone()
        frozen_copy._frozen = True
        return frozen_copy

    def fingerprint(self) -> str:
        """Return a hash of the functions, names and numbers that define the problem (hex, 16 digits)."""
        return compute_problem_fingerprint(self)

    def require_mutable(self) -> None:
        """Raise `ProblemError` if the problem belongs to a solution."""
        if self._frozen:
            raise ProblemError(
                f"problem '{self.name}' belongs to a solution and cannot be changed: "
                "create a variation with with_bounds(), with_initial() or similar, or a new problem."
            )

    def clear_cache(self) -> None:
        """Delete objects cached from earlier declarations."""
        self.builds = {}

    def check_foreign_symbols(self, phase: Phase, expression: Any, what: str) -> None:
        """Raise `ProblemError` if an expression along a phase uses other symbols than its model and free parameters."""
        check_phase_symbols(
            phase, self.phases.values(), self.parameters, self.parameter_symbols(), expression, what
        )

    def clone(self) -> Problem:
        """Return a mutable copy with its own numbers and shared symbols and cache."""
        clone = copy.copy(self)
        clone._frozen = False
        clone.phases = {name: phase.clone(clone) for name, phase in self.phases.items()}
        clone.constraints = dict(self.constraints)
        clone._parameters = dict(self._parameters)
        clone.parameter_bounds = dict(self.parameter_bounds)
        clone.parameter_guess = dict(self.parameter_guess)
        return clone

    def _set_cost_expression(self, cost: Any, sense: float, unit: str) -> None:
        self.require_mutable()
        if self.cost is not None:
            raise ProblemError(f"problem '{self.name}' has two costs: keep one minimize() or maximize().")
        expression = convert_to_sx_column(cost, f"the cost of problem '{self.name}'", 1, ProblemError)
        what = f"the cost of problem '{self.name}'"
        check_boundary_symbols(self.phases.values(), self.parameter_symbols(), expression, what)
        require_type(unit, str, f"the unit of {what}", 'write unit="kg"')
        self.cost, self.sense, self.stated_cost_unit = expression, sense, unit
        self.clear_cache()


def _convert_interval_to_time_argument(interval: Interval) -> Any:
    lower, upper = float(interval.lower[0]), float(interval.upper[0])
    if lower == upper:
        return lower
    return (lower if np.isfinite(lower) else None, upper if np.isfinite(upper) else None)
