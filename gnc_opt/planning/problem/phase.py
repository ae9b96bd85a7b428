"""Phase: one model over one span of time, with its boundary values, bounds and constraints."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import Strict, read_label
from gnc_opt.arrays import Array
from gnc_opt.errors import ProblemError, unknown_name
from gnc_opt.model.composed_controls import VectorControl
from gnc_opt.model.model import Model
from gnc_opt.model.variables import Layout, Symbol, Variable, as_expression, as_magnitudes
from gnc_opt.planning.problem.arcs import Held, Junction, Smooth, read_arc_kinds
from gnc_opt.planning.problem.constraints import Constraint, make_constraint
from gnc_opt.planning.problem.control_states import (
    add_phase_fraction,
    limit_control_rates,
    make_polynomial_controls,
    split_time_bounds,
)
from gnc_opt.planning.problem.guess.values import GuessValue
from gnc_opt.planning.problem.interval import (
    Interval,
    by_name,
    default_control_bounds,
    intersect,
    magnitude_ranges,
    read_interval,
    split_control_ranges,
    stack_intervals,
    stack_ranges,
    unbounded,
    with_ranges,
)
from gnc_opt.planning.problem.phase_bounds_and_guess import PhaseNumbers, Restatement, read_duration


class Owner(Protocol):
    """Interface of a problem for its phases."""

    name: str
    phases: dict[str, Phase]

    def refuse_if_frozen(self) -> None: ...

    def forget_builds(self) -> None: ...

    def check_foreign_symbols(self, leg: Phase, expression: Any, what: str, /) -> None: ...

    def cache(self, key: Any, build: Callable[[], Any], /) -> Any: ...


_STATEMENTS = (
    "bounds", "duration", "final", "final_state", "final_time", "fraction", "guess", "hold", "initial",
    "initial_state", "initial_time", "integral", "model", "name", "norm_bounds", "path", "polynomials",
    "rates", "scale", "time",
)  # fmt: skip
"""What users state or read of a phase; the rest serves the problem and the transcription."""


class Phase(Strict):
    """One span of time of a problem; made by ``Problem.phase``.

    In every call a number, list or array is a fixed value, a tuple ``(lower, upper)`` is a range and
    ``None`` is free; of a scalar, a list of two is a range, too. Names are those of the model's variables.

    Examples
    --------
    >>> leg = problem.get_phase("leg")
    >>> print(leg.model.name)
    double integrator
    """

    __slots__ = (
        "_curved",
        "_ends",
        "_owner",
        "_told_on_sphere",
        "final_time",
        "follows",
        "handed",
        "initial_time",
        "integrands",
        "model",
        "name",
        "numbers",
        "own_states",
        "paths",
        "restatement",
        "told",
    )

    def __init__(self, name: str, model: Model, owner: Owner) -> None:
        self.name = name
        self.model = model
        self._owner = owner
        n, controls = model.states.size, default_control_bounds(model)
        duration = read_duration(None, name)
        self.numbers = PhaseNumbers(None, None, duration, unbounded(n), unbounded(n), unbounded(n), controls)
        self.paths: dict[str, Constraint] = {
            f"equation of {z}": make_constraint(
                f"equation of {z}", g, None, None, 0.0, f"the equation of '{z}'"
            )
            for z, g in model.equations.items()
        }
        self._curved: set[str] = set()
        self._told_on_sphere: dict[str, bool] = {}
        for vector in self.vector_controls:
            self._limit_direction_length(vector)
        self.restatement: Restatement | None = None
        self.handed: dict[str, tuple[str, Array]] = {}
        self.follows: str | None = None
        self.told: dict[tuple[str, str], Array] = {}
        self.integrands: dict[str, tuple[Any, Any]] = {}
        # These begin anew in the next phase, unless a link names them.
        self.own_states: frozenset[str] = frozenset()
        self._create_boundary_symbols()
        self._record_nonaffine_vectors(model.derivative())

    def _create_boundary_symbols(self) -> None:
        self.initial_time: Any = ca.SX.sym(f"{self.name}_initial_time")
        self.final_time: Any = ca.SX.sym(f"{self.name}_final_time")
        self._ends = {
            end: {
                v.name: ca.SX.sym(f"{self.name}_{end}_{v.name}", v.size) for v in self.model.states.variables
            }
            for end in ("initial", "final")
        }

    def __dir__(self) -> list[str]:
        return list(_STATEMENTS)

    def __repr__(self) -> str:
        return f"Phase({self.name!r} on {self.model!r})"

    # --- end-point symbols ------------------------------------------------------------------------

    @property
    def duration(self) -> Any:
        """The expression final_time - initial_time (s)."""
        return self.final_time - self.initial_time

    def initial_state(self, name: str | Symbol) -> Any:
        """Return the symbol of a state at the phase's start, for costs and boundary constraints."""
        return self._get_boundary_symbol("initial", name)

    def final_state(self, name: str | Symbol) -> Any:
        """Return the symbol of a state at the phase's end, for costs and boundary constraints."""
        return self._get_boundary_symbol("final", name)

    def end_states(self, end: str) -> Any:
        """Return the stacked end-point states, ``end`` being "initial" or "final"."""
        return ca.vertcat(*self._ends[end].values())

    # --- declarations -----------------------------------------------------------------------------

    def time(self, initial: Any = 0.0, final: Any = None, *, duration: Any = None) -> None:
        """State when the phase starts and ends (s): values, ranges or ``None`` (free).

        Parameters
        ----------
        initial, final : float, tuple or None
        duration : tuple (lower, upper), optional
            Range of ``final - initial``; its lower end defaults to 0.
        """
        self._set_numbers(
            initial_time=read_interval(initial, 1, f"the initial time of {self.label}"),
            final_time=read_interval(final, 1, f"the final time of {self.label}"),
            duration=self.numbers.duration if duration is None else read_duration(duration, self.label),
        )
        self._owner.forget_builds()

    def initial(self, **values: Any) -> None:
        """State initial values by name, of states and of controls with `rates` or `polynomials`; others are free."""
        self._set_numbers(initial=self._replace_end_values(self.numbers.initial, values, "initial value"))

    def final(self, **values: Any) -> None:
        """State final values by name, of states and of controls with `rates` or `polynomials`; others are free."""
        self._set_numbers(final=self._replace_end_values(self.numbers.final, values, "final value"))

    def bounds(self, **ranges: Any) -> None:
        """State bounds of states and controls over the whole phase: ``bounds(a=(-1, 1), v=(None, 3))``.

        An end may be a function of time, a table of it, or an expression of ``model.time``, `fraction` and parameters:
        ``bounds(a=(0.0, lambda t: 1.0 + t))``. It becomes the path constraint ``upper bound of a``.
        """
        ranges = split_time_bounds(self, ranges)
        states, controls = self._split_variables(
            split_control_ranges(self.model, ranges, self.label), "bounds"
        )
        self._set_numbers(
            states=with_ranges(self.numbers.states, self.model.states, states, "bounds", self.label),
            controls=with_ranges(self.numbers.controls, self.model.controls, controls, "bounds", self.label),
        )

    def norm_bounds(self, **ranges: Any) -> None:
        """State bounds of the Euclidean norm of vector controls over the whole phase: ``norm_bounds(T=(0.0, 5.0))``.

        A lower limit > 0 leaves an annulus, which is not convex; other than with ``T @ T >= lower**2`` its centre is
        no place where derivatives vanish.

        Raises
        ------
        ProblemError
            The name is not that of a ``Model.vector_control``, or the range has no number >= 0.
        """
        self.bounds(**magnitude_ranges(self.model, split_time_bounds(self, ranges), self.label))

    def path(
        self, name: str, expression: Any = None, *, lower: Any = None, upper: Any = None, equals: Any = None
    ) -> None:
        """Add a path constraint ``lower <= expression(t, x, u, p) <= upper`` along the phase.

        Parameters
        ----------
        name : str
            Unique in the phase; appears in reports and multipliers.
        expression : casadi.SX or list
            In the symbols of the phase's model; or an inequality or equation, ``T.T @ T <= d**2``, without limits.
        lower, upper : float or array, optional
            At least one of them, unless ``equals`` is given.
        equals : float or array, optional
            For an equality.
        """
        read_label(name, f"path constraint of {self.label}", ProblemError)
        what = f"path constraint '{name}' of {self.label}"
        if name in self.paths:
            raise ProblemError(f"{self.label} has two path constraints '{name}': rename one.")
        constraint = make_constraint(name, expression, lower, upper, equals, what)
        self._owner.check_foreign_symbols(self, constraint.expression, what)
        self._owner.refuse_if_frozen()
        self.paths[name] = constraint
        self._record_nonaffine_vectors(constraint.expression)
        self._owner.forget_builds()

    @property
    def is_linked(self) -> bool:
        """Whether states of this phase are handed over, to it or from it."""
        return bool(self.handed) or any(
            self.name in {f for f, _ in leg.handed.values()} for leg in self.all_phases
        )

    def drop_path(self, name: str) -> None:
        """Remove a path constraint, if there is one of that name."""
        self._owner.refuse_if_frozen()
        if self.paths.pop(name, None) is not None:
            self._owner.forget_builds()

    def integral(self, integrand: Any, name: str | None = None) -> Any:
        """Return the symbol of the integral of ``integrand(t, x, u, p)`` over the phase.

        Use it in the cost (a Lagrange term) or in constraints.
        """
        label = f"integral_{len(self.integrands) + 1}" if name is None else name
        remedy = 'its name comes last, write integral(expression, "name")'
        read_label(label, f"integral of {self.label}", ProblemError, instead=remedy)
        what = f"integral '{label}' of {self.label}"
        if label in self.integrands:
            raise ProblemError(f"{self.label} has two integrals '{label}': rename one.")
        value = as_expression(integrand, what, 1, ProblemError)
        self._owner.check_foreign_symbols(self, value, what)
        self._owner.refuse_if_frozen()
        symbol = ca.SX.sym(f"{self.name}_{label}")
        self.integrands[label] = (symbol, value)
        self._record_nonaffine_vectors(value)
        self._owner.forget_builds()
        return symbol

    def guess(self, time: ArrayLike | None = None, **values: GuessValue) -> None:
        """Give a starting trajectory; whatever is left out is guessed.

        Parameters
        ----------
        time : array (n_times,), optional
            Times of array-valued guesses; its ends are also the guess of initial and final time. Arrays that were
            given before keep their own times if others come with new ones, and move to these if given alone.
        **values
            By name of state or control: a constant, a tuple ``(start, end)`` (straight line), an array
            (n, n_times), or a function of time that returns the value.
        """
        guess, known = self.numbers.guess, self.guessable_names
        sizes = {
            name: (known.get(name) or self._find_layout_of_variable(name, "guess")[name]).size
            for name in {**guess.values, **values}
        }
        self._set_numbers(guess=guess.join_guess_values(time, values, sizes, self.label))

    def scale(self, **magnitudes: ArrayLike) -> None:
        """Override the automatic scaling: typical magnitudes > 0 of states or controls by name.

        Answers and costates do not depend on scales; convergence may.
        """
        scales = dict(self.numbers.scales)
        for name, magnitude in magnitudes.items():
            size = self._find_layout_of_variable(name, "scale")[name].size
            scales[name] = as_magnitudes(magnitude, size, f"the scale of '{name}' in {self.label}")
        self._set_numbers(scales=scales)

    def rates(self, **ranges: Any) -> None:
        """State ranges of the time derivatives of controls: ``rates(a=(-1, 1))``; ``None`` is any rate.

        The control is a state of the phase from then on, continuous, with values at both ends and a costate, and
        ``a_rate`` is the control; see `gnc_opt.planning.problem.control_states`.

        Raises
        ------
        ProblemError
            The name is that of no control, or of one that is made of others.
        """
        limit_control_rates(self, ranges)

    def polynomials(self, **degrees: int) -> None:
        """Make controls polynomials of time of a given degree over the whole phase: ``polynomials(a=3)``.

        The control is a state of the phase from then on, with values at both ends; the coefficients of its derivative,
        constant states ``a_coefficients``, are optimised.

        Raises
        ------
        ProblemError
            As in `rates`, or a degree that is no integer >= 0.
        """
        make_polynomial_controls(self, degrees)

    @property
    def fraction(self) -> Any:
        """The symbol of the share of the phase that has passed, from 0 to 1, for bounds and expressions along it."""
        return add_phase_fraction(self)

    def add_states(
        self,
        rates: Mapping[Symbol, Any],
        controls: Sequence[Symbol] = (),
        ends: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        """Add states, which may have been controls, with their rates and symbols at both ends; bounds stay by name."""
        old, box = self.model, self.numbers
        self._owner.refuse_if_frozen()
        model = old.with_states(rates, controls)
        bounds = {**by_name(box.states, old.states), **by_name(box.controls, old.controls)}
        self._set_numbers(
            states=stack_ranges(bounds, model.states),
            controls=stack_ranges(bounds, model.controls),
            initial=stack_ranges(by_name(box.initial, old.states), model.states),
            final=stack_ranges(by_name(box.final, old.states), model.states),
        )
        self.model = model
        for end, symbols in self._ends.items():
            symbols.update({} if ends is None else ends[end])
            for v in model.states.variables:
                symbols.setdefault(v.name, ca.SX.sym(f"{self.name}_{end}_{v.name}", v.size))
        self._owner.forget_builds()

    def create_following_phases(self, names: Sequence[str]) -> list[Phase]:
        """Return phases like this one, the last one with its final values, which it loses; see `Problem.divide`."""
        final, none = self.numbers.final, unbounded(self.model.states.size)
        self._set_numbers(final=none)
        found = [self.clone() for _ in names]
        for name, twin in zip(names, found, strict=True):
            twin.name = name
            twin._set_numbers(initial=none)
            twin._create_boundary_symbols()
        found[-1]._set_numbers(final=final)
        return found

    def hold(
        self,
        arcs: ArrayLike | None,
        *,
        paths: ArrayLike | None = None,
        states: ArrayLike | None = None,
        smooth: tuple[Smooth, ...] = (),
        junctions: tuple[Junction, ...] = (),
    ) -> None:
        """Hold controls on their bounds, segment by segment, for a mesh of K segments.

        Parameters
        ----------
        arcs : array (n_controls, K) of ArcKind or int, or None
            LOWER (or -1): on the lower bound, UPPER (+1): on the upper bound, INTERIOR (0): free within its
            bounds, RELEASED: free of its bounds. With free breakpoints only the switch times remain to optimise.
            ``None`` releases all controls.
        paths : array (n_paths, K), optional
            The same for the rows of the path constraints.
        states : array (n_states, K), optional
            LOWER or UPPER: on that bound, INTERIOR: within bounds, RELEASED: free of them. A bound of higher order (the
            state's own derivative depends on no control) needs a junction where the arc begins.
        smooth : tuple of Smooth
        smooth, junctions : tuple
            Controls that are one polynomial over several segments; mesh boundaries where a state meets its bound.
        """
        if arcs is None:
            self._set_numbers(arcs=None)
            return
        model, box = self.model, self.numbers
        rows = {
            "controls": (arcs, model.controls.labels, box.controls),
            "paths": (paths, self.path_labels, self.path_interval()),
            "states": (states, model.states.labels, box.states),
        }
        kinds = {
            name: read_arc_kinds(given, labels, limits, name, self.label)
            for name, (given, labels, limits) in rows.items()
            if given is not None
        }
        self._set_numbers(arcs=Held(**kinds, smooth=tuple(smooth), junctions=tuple(junctions)))

    # --- internals --------------------------------------------------------------------------------

    @property
    def label(self) -> str:
        """ "phase 'leg' of problem '...'", for messages."""
        return f"phase '{self.name}' of problem '{self._owner.name}'"

    def time_ranges(self) -> tuple[Interval, Interval]:
        """Return the ranges of initial and final time; if one is a number, the duration narrows the other."""
        initial, final, span = self.numbers.initial_time, self.numbers.final_time, self.numbers.duration
        if initial is None or final is None:
            raise ProblemError(f"{self.label} has no times: call time(initial=..., final=...).")
        if initial.fixed[0] and not final.fixed[0]:
            return initial, intersect(final, Interval(initial.lower + span.lower, initial.lower + span.upper))
        if final.fixed[0] and not initial.fixed[0]:
            return intersect(initial, Interval(final.lower - span.upper, final.lower - span.lower)), final
        return initial, final

    @property
    def guessable_names(self) -> dict[str, Variable]:
        """All that a guess may name: states, controls, and the controls that are made of those."""
        model = self.model
        composed = (control.variable for control in model.composed_controls.values())
        return {v.name: v for v in (*model.states.variables, *model.controls.variables, *composed)}

    @property
    def path_labels(self) -> tuple[str, ...]:
        """Names of the rows of all path constraints, in order."""
        return tuple(label for c in self.paths.values() for label in c.labels)

    def path_interval(self) -> Interval:
        """Bounds of all path constraint rows, in order."""
        boxes = {name: c.interval for name, c in self.paths.items()}
        boxes |= {
            v.length: Interval(np.ones(1), np.ones(1))
            for v in self.vector_controls
            if self.has_unit_direction(v)
        }
        return stack_intervals(boxes.values())

    @property
    def vector_controls(self) -> tuple[VectorControl, ...]:
        """The vector controls of the model."""
        return tuple(c for c in self.model.composed_controls.values() if isinstance(c, VectorControl))

    def has_unit_direction(self, vector: VectorControl) -> bool:
        """Whether the direction of a vector control has length 1 everywhere, instead of at most 1.

        It has where the norm is never zero, and where functions are not affine in the vector.
        """
        if vector.name in self._told_on_sphere:
            return self._told_on_sphere[vector.name]
        least = self.numbers.controls.lower[self.model.controls.slice(vector.magnitude)]
        return bool(least[0] > 0) or vector.name in self._curved

    def record_vector_control(self, vector: VectorControl, *, on_sphere: bool | None) -> None:
        """Record that model, constraints, integrands use a vector control; see `has_unit_direction`, None decides."""
        lengths = {v.length for v in self.vector_controls}
        constraints = [c.expression for name, c in self.paths.items() if name not in lengths]
        for expression in (self.model.derivative(), self.integrand_expression(), *constraints):
            self._record_nonaffine_vectors(expression)
        self._limit_direction_length(vector)
        if on_sphere is not None:
            self._told_on_sphere[vector.name] = on_sphere

    def _limit_direction_length(self, vector: VectorControl) -> None:
        square = ca.sumsqr(self.model.symbol(vector.direction))
        what = f"the direction of '{vector.name}'"
        self.paths[vector.length] = make_constraint(vector.length, square, None, 1.0, None, what)

    def _record_nonaffine_vectors(self, expression: Any) -> None:
        for vector in self.vector_controls:
            direction = self.model.symbol(vector.direction)
            if any(ca.which_depends(expression, direction, 2, True)):
                self._curved.add(vector.name)

    def path_expression(self) -> Any:
        """Stacked SX expression of all path constraints."""
        return ca.vertcat(*[c.expression for c in self.paths.values()]) if self.paths else ca.SX(0, 1)

    def cache(self, key: str, build: Callable[[], Any]) -> Any:
        """Return what was built for this phase, or its variations with other numbers, before."""
        return self._owner.cache((key, self.name), build)

    def integrand_expression(self) -> Any:
        """Stacked SX expression of all integrands."""
        return ca.vertcat(*[e for _, e in self.integrands.values()]) if self.integrands else ca.SX(0, 1)

    def integral_symbols(self) -> Any:
        """Stacked SX symbols of all integrals."""
        return ca.vertcat(*[s for s, _ in self.integrands.values()]) if self.integrands else ca.SX(0, 1)

    @property
    def all_phases(self) -> tuple[Phase, ...]:
        """All phases of the problem, this one among them."""
        return tuple(self._owner.phases.values())

    def find_state_source(self, state: str) -> tuple[Phase, Array] | None:
        """Return the earlier phase that a link takes a state from, and the jump (n,); None if it begins here."""
        if state not in self.handed:
            return None
        first, jump = self.handed[state]
        order = list(self._owner.phases)
        return (self._owner.phases[first], jump) if order.index(first) < order.index(self.name) else None

    def clone(self, owner: Owner | None = None) -> Phase:
        """Return a copy, for another problem maybe, which shares the symbols and owns its numbers."""
        twin = copy.copy(self)
        twin.paths, twin.integrands = dict(self.paths), dict(self.integrands)
        twin._ends = {end: dict(symbols) for end, symbols in self._ends.items()}
        twin._curved, twin._told_on_sphere = set(self._curved), dict(self._told_on_sphere)
        twin.handed, twin.told = dict(self.handed), dict(self.told)
        twin._owner = owner or self._owner
        return twin

    def _set_numbers(self, **numbers: Any) -> None:
        self._owner.refuse_if_frozen()
        self.numbers = replace(self.numbers, **numbers)

    def _replace_end_values(self, old: Interval, values: Mapping[str, Any], what: str) -> Interval:
        jumping = next((name for name in values if name in self.model.controls), None)
        if jumping is not None:
            raise ProblemError(
                f"the {what} of control '{jumping}' in {self.label} changes nothing, because a control may jump there: "
                f"limit its rate before, rates({jumping}=(-1.0, 1.0)), or leave it out."
            )
        return with_ranges(old, self.model.states, values, what, self.label)

    def _get_boundary_symbol(self, end: str, name: str | Symbol) -> Any:
        key = name.variable.name if isinstance(name, Symbol) else name
        if not isinstance(key, str) or key not in self._ends[end]:
            raise unknown_name("state", key, self.label, self._ends[end])
        return self._ends[end][key]

    def _split_variables(self, values: Mapping[str, Any], what: str) -> tuple[dict[str, Any], dict[str, Any]]:
        states: dict[str, Any] = {}
        controls: dict[str, Any] = {}
        for name, value in values.items():
            (states if self._find_layout_of_variable(name, what).kind == "state" else controls)[name] = value
        return states, controls

    def _find_layout_of_variable(self, name: str, what: str) -> Layout:
        for layout in (self.model.states, self.model.controls):
            if name in layout:
                return layout
        known = [*self.model.states.names, *self.model.controls.names]
        if name in self.model.parameters:
            raise ProblemError(
                f"{what}() of {self.label} got '{name}', which is a parameter of the model: use "
                "Problem.parameter() to "
                "optimise it or with_parameters() to change it."
            )
        raise unknown_name("state or control", name, f"{what}() of {self.label}", known)
