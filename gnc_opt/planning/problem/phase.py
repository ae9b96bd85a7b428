"""Phase: a model over a time interval, with boundary values, bounds and constraints."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import StrictAttributes, read_display_name
from gnc_opt.array_types import Array
from gnc_opt.errors import ProblemError, unknown_name_error
from gnc_opt.model.model_variables import (
    Layout,
    Symbol,
    Variable,
    convert_to_sx_column,
    read_nominal_magnitudes,
)
from gnc_opt.model.split_and_magnitude_direction_controls import VectorControl
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.planning.problem.active_constraint_arcs import FixedArcs, Junction, SmoothControl, read_arc_kinds
from gnc_opt.planning.problem.bounds import (
    Interval,
    convert_bounds_to_split_controls,
    get_control_bounds,
    intersect_bounds,
    read_norm_ranges,
    read_value_or_range,
    replace_bounds_by_name,
    split_bounds_by_name,
    stack_intervals,
    stack_named_bounds,
    unbounded_interval,
)
from gnc_opt.planning.problem.constraints import Constraint, make_constraint
from gnc_opt.planning.problem.controls_as_states import (
    add_elapsed_fraction_state,
    limit_control_rates,
    make_polynomial_controls,
    split_time_dependent_bounds,
)
from gnc_opt.planning.problem.guess.guess_evaluation import GuessValue
from gnc_opt.planning.problem.phase_bounds_and_guess import ControlMap, PhaseBoundsAndGuess, read_duration


class PhaseOwner(Protocol):
    """Interface of a problem for its phases."""

    name: str
    phases: dict[str, Phase]

    def require_mutable(self) -> None: ...

    def clear_cache(self) -> None: ...

    def check_foreign_symbols(self, phase: Phase, expression: Any, what: str, /) -> None: ...

    def memoize(self, key: Any, build: Callable[[], Any], /) -> Any: ...


_STATEMENTS = (
    "bounds", "duration", "final", "final_state", "final_time", "fraction", "guess", "hold", "initial",
    "initial_state", "initial_time", "integral", "model", "name", "norm_bounds", "path", "polynomials",
    "rates", "scale", "time",
)  # fmt: skip
"""Public names of a phase; other attributes are for the problem and the transcription."""


class Phase(StrictAttributes):
    """Time interval of a problem with one model; created by ``Problem.phase``.

    In every call a number, list or array is a fixed value, a tuple ``(lower, upper)`` is a range and
    ``None`` is free; for a scalar a list of two is also a range. Names are those of the model's variables.

    Examples
    --------
    >>> leg = problem.get_phase("leg")
    >>> print(leg.model.name)
    double integrator
    """

    __slots__ = (
        "_ends",
        "_nonaffine_vectors",
        "_owner",
        "_unit_directions",
        "control_map",
        "final_time",
        "initial_time",
        "integrands",
        "known_ends",
        "linked_states",
        "model",
        "name",
        "numbers",
        "own_states",
        "paths",
        "preceding_phase",
    )

    def __init__(self, name: str, model: Model, owner: PhaseOwner) -> None:
        self.name = name
        self.model = model
        self._owner = owner
        initial, final, states = (unbounded_interval(model.states.size) for _ in range(3))
        duration, controls = read_duration(None, name), get_control_bounds(model)
        self.numbers = PhaseBoundsAndGuess(None, None, duration, initial, final, states, controls)
        self.paths: dict[str, Constraint] = {
            f"equation of {z}": make_constraint(
                f"equation of {z}", g, None, None, 0.0, f"the equation of '{z}'"
            )
            for z, g in model.algebraic_equations.items()
        }
        self._nonaffine_vectors: set[str] = set()
        self._unit_directions: dict[str, bool] = {}
        for vector in self.vector_controls:
            self._constrain_direction_to_unit_length(vector)
        self.control_map: ControlMap | None = None
        self.linked_states: dict[str, tuple[str, Array]] = {}
        self.preceding_phase: str | None = None
        self.known_ends: dict[tuple[str, str], Array] = {}
        self.integrands: dict[str, tuple[Any, Any]] = {}
        # These states start again in the next phase, unless a link names them.
        self.own_states: frozenset[str] = frozenset()
        self._create_boundary_symbols()
        self._record_nonaffine_vector_controls(model.state_derivative())

    def _create_boundary_symbols(self) -> None:
        self.initial_time: Any = Symbol(Variable(f"{self.name}_initial_time"))
        self.final_time: Any = Symbol(Variable(f"{self.name}_final_time"))
        self._ends = {
            end: {
                v.name: Symbol(Variable(f"{self.name}_{end}_{v.name}", v.size))
                for v in self.model.states.variables
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
        """Expression final_time - initial_time (s)."""
        return self.final_time - self.initial_time

    def initial_state(self, name: str | Symbol) -> Any:
        """Return the symbol of a state at the start of the phase, for costs and boundary constraints."""
        return self._get_boundary_symbol("initial", name)

    def final_state(self, name: str | Symbol) -> Any:
        """Return the symbol of a state at the end of the phase, for costs and boundary constraints."""
        return self._get_boundary_symbol("final", name)

    def end_states(self, end: str) -> Any:
        """Return the stacked end-point states; ``end`` is "initial" or "final"."""
        return ca.vertcat(*self._ends[end].values())

    # --- declarations -----------------------------------------------------------------------------

    def time(self, initial: Any = 0.0, final: Any = None, *, duration: Any = None) -> None:
        """Set initial and final time of the phase (s): values, ranges or ``None`` (free).

        Parameters
        ----------
        initial, final : float, tuple or None
        duration : tuple (lower, upper), optional
            Range of ``final - initial``; the default lower end is 0.
        """
        self._replace_bounds_and_guess(
            initial_time=read_value_or_range(initial, 1, f"the initial time of {self.label}"),
            final_time=read_value_or_range(final, 1, f"the final time of {self.label}"),
            duration=self.numbers.duration if duration is None else read_duration(duration, self.label),
        )
        self._owner.clear_cache()

    def initial(self, **values: Any) -> None:
        """Set initial values by name, for states and for controls with `rates` or `polynomials`; others are free."""
        self._replace_bounds_and_guess(
            initial=self._replace_end_state_bounds(self.numbers.initial, values, "initial value")
        )

    def final(self, **values: Any) -> None:
        """Set final values by name, for states and for controls with `rates` or `polynomials`; others are free."""
        self._replace_bounds_and_guess(
            final=self._replace_end_state_bounds(self.numbers.final, values, "final value")
        )

    def bounds(self, **ranges: Any) -> None:
        """Set bounds of states and controls over the whole phase: ``bounds(a=(-1, 1), v=(None, 3))``.

        An end may be a function of time, a table over time, or an expression as in `path`:
        ``bounds(a=(0.0, lambda t: 1.0 + t))``. It becomes the path constraint ``upper bound of a``.
        """
        ranges = split_time_dependent_bounds(self, ranges)
        states, controls = self._split_states_and_controls(
            convert_bounds_to_split_controls(self.model, ranges, self.label), "bounds"
        )
        self._replace_bounds_and_guess(
            states=replace_bounds_by_name(
                self.numbers.states, self.model.states, states, "bounds", self.label
            ),
            controls=replace_bounds_by_name(
                self.numbers.controls, self.model.controls, controls, "bounds", self.label
            ),
        )

    def norm_bounds(self, **ranges: Any) -> None:
        """Set bounds of the Euclidean norm of vector controls over the whole phase: ``norm_bounds(T=(0.0, 5.0))``.

        With a lower limit > 0 the feasible set is an annulus and not convex. Unlike with ``T @ T >= lower**2``, the
        derivatives do not vanish at its centre.

        Raises
        ------
        ProblemError
            The name is not that of a ``Model.vector_control``, or the range contains no number >= 0.
        """
        self.bounds(**read_norm_ranges(self.model, split_time_dependent_bounds(self, ranges), self.label))

    def path(
        self,
        name: str,
        expression: Any = None,
        *,
        lower: Any = None,
        upper: Any = None,
        equals: Any = None,
        unit: str = "",
    ) -> None:
        """Add a path constraint ``lower <= expression(t, x, u, p) <= upper`` along the phase.

        Parameters
        ----------
        name : str
            Unique in the phase; used in reports and for multipliers.
        expression : casadi.SX or list
            Expression of the model's symbols; or an inequality or equation, ``T.T @ T <= d**2``, without limits.
        lower, upper : float or array, optional
            At least one of them, unless ``equals`` is given.
        equals : float or array, optional
            Value of an equality constraint.
        unit : str
            Unit of the expression in figures and reports.
        """
        read_display_name(name, f"path constraint of {self.label}", ProblemError)
        what = f"path constraint '{name}' of {self.label}"
        if name in self.paths:
            raise ProblemError(f"{self.label} has two path constraints '{name}': rename one.")
        constraint = make_constraint(name, expression, lower, upper, equals, what)
        self._owner.check_foreign_symbols(self, constraint.expression, what)
        self._owner.require_mutable()
        self.paths[name] = replace(constraint, unit=unit)
        self._record_nonaffine_vector_controls(constraint.expression)
        self._owner.clear_cache()

    @property
    def is_linked(self) -> bool:
        """Whether states of this phase are linked to another phase."""
        return bool(self.linked_states) or any(
            self.name in {f for f, _ in phase.linked_states.values()} for phase in self.all_phases
        )

    def drop_path(self, name: str) -> None:
        """Remove the path constraint with this name, if it exists."""
        self._owner.require_mutable()
        if self.paths.pop(name, None) is not None:
            self._owner.clear_cache()

    def integral(self, integrand: Any, name: str | None = None) -> Any:
        """Return the symbol of the integral of ``integrand(t, x, u, p)`` over the phase.

        Use it in the cost (Lagrange term) or in constraints.
        """
        label = f"integral_{len(self.integrands) + 1}" if name is None else name
        remedy = 'its name comes last, write integral(expression, "name")'
        read_display_name(label, f"integral of {self.label}", ProblemError, instead=remedy)
        what = f"integral '{label}' of {self.label}"
        if label in self.integrands:
            raise ProblemError(f"{self.label} has two integrals '{label}': rename one.")
        value = convert_to_sx_column(integrand, what, 1, ProblemError)
        self._owner.check_foreign_symbols(self, value, what)
        self._owner.require_mutable()
        symbol = Symbol(Variable(f"{self.name}_{label}"))
        self.integrands[label] = (symbol, value)
        self._record_nonaffine_vector_controls(value)
        self._owner.clear_cache()
        return symbol

    def guess(self, time: ArrayLike | None = None, **values: GuessValue) -> None:
        """Set the initial guess; omitted parts are generated.

        Parameters
        ----------
        time : array (n_times,), optional
            Times of array-valued guesses; its ends are also the guess of initial and final time. Arrays of earlier
            calls keep their times if new arrays are given, and get the new times if ``time`` is given alone.
        **values
            By name: a constant, a tuple ``(start, end)`` (linear), an array (n, n_times), or a function of time.
        """
        guess, known = self.numbers.guess, self.guessable_names
        sizes = {
            name: (known.get(name) or self._get_state_or_control_layout(name, "guess")[name]).size
            for name in {**guess.values, **values}
        }
        self._replace_bounds_and_guess(
            guess=guess.add_guess_times_and_values(time, values, sizes, self.label)
        )

    def scale(self, **magnitudes: ArrayLike) -> None:
        """Override the automatic scaling by typical magnitudes > 0 of states or controls by name.

        Solutions and costates do not depend on scales; convergence may.
        """
        scales = dict(self.numbers.scales)
        for name, magnitude in magnitudes.items():
            size = self._get_state_or_control_layout(name, "scale")[name].size
            scales[name] = read_nominal_magnitudes(magnitude, size, f"the scale of '{name}' in {self.label}")
        self._replace_bounds_and_guess(scales=scales)

    def rates(self, **ranges: Any) -> None:
        """Set ranges of the time derivatives of controls: ``rates(a=(-1, 1))``; ``None`` is any rate.

        The control becomes a continuous state with boundary values and a costate; the new control is ``a_rate``, see
        `gnc_opt.planning.problem.controls_as_states`.

        Raises
        ------
        ProblemError
            The name is not a control, or is a composed control.
        """
        limit_control_rates(self, ranges)

    def polynomials(self, **degrees: int) -> None:
        """Make controls polynomials of time of a given degree over the whole phase: ``polynomials(a=3)``.

        The control becomes a state with boundary values. The coefficients of its derivative, constant states
        ``a_coefficients``, are optimised.

        Raises
        ------
        ProblemError
            As in `rates`, or a degree that is not an integer >= 0.
        """
        make_polynomial_controls(self, degrees)

    @property
    def fraction(self) -> Any:
        """Symbol of the elapsed share of the phase, from 0 to 1, for bounds and expressions along the phase."""
        return add_elapsed_fraction_state(self)

    def add_states(self, rates: Mapping[Symbol, Any], controls: Sequence[Symbol] = ()) -> None:
        """Add states (possibly former controls) with their rates; named bounds are kept."""
        old, numbers = self.model, self.numbers
        self._owner.require_mutable()
        model = old.with_states(rates, controls)
        bounds = {
            **split_bounds_by_name(numbers.states, old.states),
            **split_bounds_by_name(numbers.controls, old.controls),
        }
        self._replace_bounds_and_guess(
            states=stack_named_bounds(bounds, model.states),
            controls=stack_named_bounds(bounds, model.controls),
            initial=stack_named_bounds(split_bounds_by_name(numbers.initial, old.states), model.states),
            final=stack_named_bounds(split_bounds_by_name(numbers.final, old.states), model.states),
        )
        self.model = model
        for end, symbols in self._ends.items():
            for v in model.states.variables:
                symbols.setdefault(v.name, Symbol(Variable(f"{self.name}_{end}_{v.name}", v.size)))
        self._owner.clear_cache()

    def create_following_phases(self, names: Sequence[str]) -> list[Phase]:
        """Return copies of this phase; its final values move to the last copy; see `Problem.divide`."""
        final, unbounded = self.numbers.final, unbounded_interval(self.model.states.size)
        self._replace_bounds_and_guess(final=unbounded)
        copies = [self.clone() for _ in names]
        for name, phase in zip(names, copies, strict=True):
            phase.name = name
            phase._replace_bounds_and_guess(initial=unbounded)
            phase._create_boundary_symbols()
        copies[-1]._replace_bounds_and_guess(final=final)
        return copies

    def hold(
        self,
        arcs: ArrayLike | None,
        *,
        paths: ArrayLike | None = None,
        states: ArrayLike | None = None,
        smooth: tuple[SmoothControl, ...] = (),
        junctions: tuple[Junction, ...] = (),
    ) -> None:
        """Prescribe arcs segment by segment, for a mesh of K segments.

        Parameters
        ----------
        arcs : array (n_controls, K) of ArcKind or int, or None
            LOWER (or -1): at the lower bound, UPPER (+1): at the upper bound, INTERIOR (0): free within the bounds,
            RELEASED: free without bounds. With free breakpoints only the switching times are optimised.
            ``None`` releases all controls.
        paths : array (n_paths, K), optional
            Kinds of the rows of the path constraints.
        states : array (n_states, K), optional
            LOWER or UPPER: at that bound, INTERIOR: within the bounds, RELEASED: without bounds. A bound of higher
            order (the state's derivative contains no control) needs a junction at the start of the arc.
        smooth, junctions : tuple
            Controls that are one polynomial over several segments; mesh breaks at which a state reaches its bound.
        """
        if arcs is None:
            self._replace_bounds_and_guess(arcs=None)
            return
        model, box = self.model, self.numbers
        rows = {
            "controls": (arcs, model.controls.labels, box.controls),
            "paths": (paths, self.path_labels, self.get_path_bounds()),
            "states": (states, model.states.labels, box.states),
        }
        kinds = {
            name: read_arc_kinds(values, labels, limits, name, self.label)
            for name, (values, labels, limits) in rows.items()
            if values is not None
        }
        self._replace_bounds_and_guess(
            arcs=FixedArcs(**kinds, smooth=tuple(smooth), junctions=tuple(junctions))
        )

    @property
    def label(self) -> str:
        """ "phase 'leg' of problem '...'", for messages."""
        return f"phase '{self.name}' of problem '{self._owner.name}'"

    def time_ranges(self) -> tuple[Interval, Interval]:
        """Return the ranges of initial and final time; if one is fixed, the duration narrows the other."""
        initial, final, span = self.numbers.initial_time, self.numbers.final_time, self.numbers.duration
        if initial is None or final is None:
            raise ProblemError(f"{self.label} has no times: call time(initial=..., final=...).")
        if initial.is_fixed[0] and not final.is_fixed[0]:
            reachable = Interval(initial.lower + span.lower, initial.lower + span.upper)
            return initial, intersect_bounds(final, reachable)
        if final.is_fixed[0] and not initial.is_fixed[0]:
            reachable = Interval(final.lower - span.upper, final.lower - span.lower)
            return intersect_bounds(initial, reachable), final
        return initial, final

    @property
    def guessable_names(self) -> dict[str, Variable]:
        """All names that a guess may contain: states, controls and composed controls."""
        model = self.model
        composed = (control.variable for control in model.composed_controls.values())
        return {v.name: v for v in (*model.states.variables, *model.controls.variables, *composed)}

    @property
    def path_labels(self) -> tuple[str, ...]:
        """Names of the rows of all path constraints, in order."""
        return tuple(label for c in self.paths.values() for label in c.labels)

    def get_path_bounds(self) -> Interval:
        """Bounds of all path constraint rows, in order."""
        boxes = {name: c.interval for name, c in self.paths.items()}
        boxes |= {
            v.direction_norm_constraint_name: Interval(np.ones(1), np.ones(1))
            for v in self.vector_controls
            if self.has_unit_direction(v)
        }
        return stack_intervals(boxes.values())

    @property
    def vector_controls(self) -> tuple[VectorControl, ...]:
        """Vector controls of the model."""
        return tuple(c for c in self.model.composed_controls.values() if isinstance(c, VectorControl))

    def has_unit_direction(self, vector: VectorControl) -> bool:
        """Return whether the direction of a vector control has length 1, instead of at most 1.

        This is the case if the norm is never zero, or if functions are not affine in the vector.
        """
        if vector.name in self._unit_directions:
            return self._unit_directions[vector.name]
        smallest = self.numbers.controls.lower[self.model.controls.slice(vector.magnitude)]
        return bool(smallest[0] > 0) or vector.name in self._nonaffine_vectors

    def record_vector_control(self, vector: VectorControl, *, on_sphere: bool | None) -> None:
        """Record that functions use a vector control; without ``on_sphere`` they decide `has_unit_direction`."""
        lengths = {v.direction_norm_constraint_name for v in self.vector_controls}
        constraints = [c.expression for name, c in self.paths.items() if name not in lengths]
        for expression in (self.model.state_derivative(), self.integrand_expression(), *constraints):
            self._record_nonaffine_vector_controls(expression)
        self._constrain_direction_to_unit_length(vector)
        if on_sphere is not None:
            self._unit_directions[vector.name] = on_sphere

    def describe_reformulation(self, *texts: str) -> None:
        """Add descriptions of a reformulation that keeps the controls."""
        identity = ControlMap.create_identity_map(self.model, texts)
        self.control_map = identity.compose_control_maps(self.control_map)

    def _constrain_direction_to_unit_length(self, vector: VectorControl) -> None:
        square = ca.sumsqr(self.model.symbol(vector.direction))
        what = f"the direction of '{vector.name}'"
        self.paths[vector.direction_norm_constraint_name] = make_constraint(
            vector.direction_norm_constraint_name, square, None, 1.0, None, what
        )

    def _record_nonaffine_vector_controls(self, expression: Any) -> None:
        for vector in self.vector_controls:
            direction = self.model.symbol(vector.direction)
            if any(ca.which_depends(expression, direction, 2)):
                self._nonaffine_vectors.add(vector.name)

    def path_expression(self) -> Any:
        """Stacked SX expression of all path constraints."""
        return ca.vertcat(*[c.expression for c in self.paths.values()]) if self.paths else ca.SX(0, 1)

    def memoize(self, key: str, build: Callable[[], Any]) -> Any:
        """Return a cached object of this phase, shared with variations of the problem."""
        return self._owner.memoize((key, self.name), build)

    def integrand_expression(self) -> Any:
        """Stacked SX expression of all integrands."""
        return ca.vertcat(*[e for _, e in self.integrands.values()]) if self.integrands else ca.SX(0, 1)

    def integral_symbols(self) -> Any:
        """Stacked SX symbols of all integrals."""
        return ca.vertcat(*[s for s, _ in self.integrands.values()]) if self.integrands else ca.SX(0, 1)

    @property
    def all_phases(self) -> tuple[Phase, ...]:
        """All phases of the problem, including this one."""
        return tuple(self._owner.phases.values())

    def find_linked_phase(self, state: str) -> tuple[Phase, Array] | None:
        """Return the earlier phase that a state is linked to, and the jump (n,); None without a link."""
        if state not in self.linked_states:
            return None
        first, jump = self.linked_states[state]
        order = list(self._owner.phases)
        return (self._owner.phases[first], jump) if order.index(first) < order.index(self.name) else None

    def clone(self, owner: PhaseOwner | None = None) -> Phase:
        """Return a copy, optionally for another problem; it shares symbols and has its own numbers."""
        clone = copy.copy(self)
        clone.paths, clone.integrands = dict(self.paths), dict(self.integrands)
        clone._ends = {end: dict(symbols) for end, symbols in self._ends.items()}
        clone._nonaffine_vectors, clone._unit_directions = (
            set(self._nonaffine_vectors),
            dict(self._unit_directions),
        )
        clone.linked_states, clone.known_ends = dict(self.linked_states), dict(self.known_ends)
        clone._owner = owner or self._owner
        return clone

    def _replace_bounds_and_guess(self, **numbers: Any) -> None:
        self._owner.require_mutable()
        self.numbers = replace(self.numbers, **numbers)

    def _replace_end_state_bounds(self, old: Interval, values: Mapping[str, Any], what: str) -> Interval:
        jumping = next((name for name in values if name in self.model.controls), None)
        if jumping is not None:
            raise ProblemError(
                f"the {what} of control '{jumping}' in {self.label} has no effect, because a control may jump there: "
                f"limit its rate before, rates({jumping}=(-1.0, 1.0)), or remove it."
            )
        return replace_bounds_by_name(old, self.model.states, values, what, self.label)

    def _get_boundary_symbol(self, end: str, name: str | Symbol) -> Any:
        key = name.variable.name if isinstance(name, Symbol) else name
        if not isinstance(key, str) or key not in self._ends[end]:
            raise unknown_name_error("state", key, self.label, self._ends[end])
        return self._ends[end][key]

    def _split_states_and_controls(
        self, values: Mapping[str, Any], what: str
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        states: dict[str, Any] = {}
        controls: dict[str, Any] = {}
        for name, value in values.items():
            kind = self._get_state_or_control_layout(name, what).kind
            (states if kind == "state" else controls)[name] = value
        return states, controls

    def _get_state_or_control_layout(self, name: str, what: str) -> Layout:
        for layout in (self.model.states, self.model.controls):
            if name in layout:
                return layout
        known = [*self.model.states.names, *self.model.controls.names]
        if name in self.model.parameters:
            raise ProblemError(
                f"{what}() of {self.label} got '{name}', which is a parameter of the model: use "
                "Problem.parameter() to optimise it or with_parameters() to change it."
            )
        raise unknown_name_error("state or control", name, f"{what}() of {self.label}", known)
