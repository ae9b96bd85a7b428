"""Initial guess by simulation: integration of the dynamics under a control law."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_integer, read_optional_mapping, read_positive_number, require_type
from gnc_opt.array_types import Array
from gnc_opt.errors import ProblemError, unknown_name_error
from gnc_opt.model.casadi_function_evaluation import build_single_point_evaluator
from gnc_opt.model.model_variables import convert_to_sx_column, read_vector
from gnc_opt.model.ode_integration import (
    CallLimit,
    Integration,
    LimitError,
    OdeError,
    Rate,
    Tolerance,
    integrate_ode,
)
from gnc_opt.numerical_tolerances import replace_tiny_by_one
from gnc_opt.planning.problem.guess.initial_guess import (
    build_phase_guess,
    guess_boundary_states,
    guess_phase_times,
    set_control_guess,
)
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.symbolic_expressions import build_function_along_phase

FRACTIONS = np.linspace(0.0, 1.0, 11)
"""Number of samples of guessed controls; the simulation uses their means."""


def with_simulated_guess(problem: Problem) -> Problem | None:
    """Return the problem with each phase simulated with the means of its guessed controls, or None on failure."""
    for name, phase in problem.phases.items():
        layout = phase.model.controls
        means = build_phase_guess(phase, FRACTIONS).controls.mean(axis=1)
        law = {control: means[layout.slice(control)] for control in layout.names}
        try:
            simulated = guess_from_simulation(problem, law, phase=name).phases[name].numbers.guess
        except ProblemError:
            return None
        states = {state: simulated.values[state] for state in phase.model.states.names}
        problem = problem.with_guess(name, simulated.time, **states)
    return problem


RTOL, STIFF_RTOL = 1e-8, 1e-5
"""Tolerances of the explicit and of the (more expensive) implicit integration; a guess needs few digits."""

EXPLICIT_MAX_RATES, IMPLICIT_MAX_RATES = 50_000, 20_000
"""Evaluations after which the explicit method is replaced by the implicit one, and after which that fails."""

_SMOOTHER = " (replace discontinuous functions such as sign(s) by tanh(s / width))"


def guess_from_simulation(
    problem: Problem,
    controls: Mapping[str, Any],
    *,
    phase: str | None = None,
    initial: Mapping[str, ArrayLike] | None = None,
    duration: float | None = None,
    until: Any = None,
    n: int = 1001,
) -> Problem:
    """Return the problem with a guess from a simulation of one phase under a control law.

    Parameters
    ----------
    problem : Problem
    controls : mapping of str to SX, number or array, or function of time
        Control law by name of control: expressions in time, states and parameters of the model, such as thrust along
        the velocity. Values are clipped to the bounds; omitted controls are at the middle of theirs.
    phase : str, optional
        Optional for a problem with one phase.
    initial : mapping of str to number or array, optional
        Initial states that the phase leaves free.
    duration : float, optional
        Duration, s; default: that of the current guess.
    until : SX, optional
        Expression in time, states and parameters; the simulation ends at its zero, at the latest after ``duration``.
    n : int
        Number of samples of the guess.

    Returns
    -------
    Problem
        See ``Problem.with_guess``.

    Raises
    ------
    ProblemError
        Unknown names, a law that uses controls, a failed integration, or an ``until`` without a zero.

    Examples
    --------
    >>> guessed = go.guess_from_simulation(problem, {"a": lambda t: -1.0 if t < 1 else 1.0}, duration=2.0)
    >>> print(f"{go.solve(guessed, tol=1e-6).objective:.6f}")
    2.000000
    """
    require_type(
        problem,
        Problem,
        "the argument of guess_from_simulation()",
        "write guess_from_simulation(problem, {...})",
    )
    require_type(controls, Mapping, "the law of guess_from_simulation()", 'write {"u": expression}')
    read_integer(n, "n of guess_from_simulation()", 2)
    selected = problem.get_phase(phase)
    t0, tf = guess_phase_times(selected)
    if duration is not None:
        tf = t0 + read_positive_number(duration, "the duration of guess_from_simulation()")
    law = _build_clipped_control_law(problem, selected, controls)
    q = problem.get_parameter_guess()
    p, start = selected.model.parameter_values, _read_initial_state(selected, initial)
    fast = build_single_point_evaluator(
        build_function_along_phase(problem, selected, "rates", selected.model.state_derivative()), p, q
    )

    def evaluate_rates(t: float, x: Array) -> Array:
        return fast(t, x, law(t, x))

    stop = None if until is None else _build_simulation_stop_event(problem, selected, until)
    sizes = replace_tiny_by_one(np.maximum(np.abs(start), np.abs(guess_boundary_states(selected)[1])))
    try:
        simulated = _integrate_guess_dynamics(evaluate_rates, start, (t0, tf), sizes, selected, stop)
    except OdeError as error:
        raise ProblemError(
            f"the simulation of {selected.label} by guess_from_simulation() failed ({error}): change the law"
            f"{_SMOOTHER if isinstance(error, LimitError) else ''}, the initial state or the duration."
        ) from None
    end = float(simulated.times[-1])
    if stop is not None and end >= tf:
        raise ProblemError(
            f"the end condition of guess_from_simulation(), {selected.label}, is "
            f"{stop(end, simulated.states[:, -1]):.4g} at the end, t = {end:.4g} s, without a zero "
            f"before: give a longer duration, or another law."
        )
    times = np.linspace(t0, end, n)
    assert simulated.dense is not None, "the dense output is an option above"
    states = simulated.dense(times)
    applied = np.stack([law(t, x) for t, x in zip(times, states.T, strict=True)], axis=1)
    values = {name: states[selected.model.states.slice(name)] for name in selected.model.states.names}
    values |= {name: applied[selected.model.controls.slice(name)] for name in selected.model.controls.names}
    return problem.with_guess(selected.name, times, **values)


def _integrate_guess_dynamics(
    rate: Rate,
    start: Array,
    times: tuple[float, float],
    sizes: Array,
    phase: Phase,
    stop: Callable[[float, Array], float] | None,
) -> Integration:
    """Integrate with an explicit method, or an implicit one for stiff dynamics."""
    labels = phase.model.states.labels
    try:
        explicit, budget = Tolerance(RTOL, sizes), CallLimit(labels, EXPLICIT_MAX_RATES)
        return integrate_ode(rate, start, times, tolerance=explicit, budget=budget, stop=stop, dense=True)
    except LimitError:
        implicit, budget = (Tolerance(STIFF_RTOL, sizes, stiff=True), CallLimit(labels, IMPLICIT_MAX_RATES))
        return integrate_ode(rate, start, times, tolerance=implicit, budget=budget, stop=stop, dense=True)


def _read_initial_state(phase: Phase, values: Mapping[str, ArrayLike] | None) -> Array:
    start = guess_boundary_states(phase)[0].copy()
    for name, value in read_optional_mapping(
        values, "initial of guess_from_simulation()", 'write {"q": 1.0}'
    ).items():
        rows = phase.model.states.slice(name)
        start[rows] = read_vector(value, phase.model.states[name].size, f"the initial value of '{name}'")
    return start


def _build_clipped_control_law(
    problem: Problem, phase: Phase, controls: Mapping[str, Any]
) -> Callable[[float, Array], Array]:
    """Return the controls, clipped to their bounds, as a function of t and x."""
    model, box = phase.model, phase.numbers.controls
    sizes = {name: v.size for name, v in phase.guessable_names.items() if name not in model.states}
    timed: dict[str, Callable[[float], Any]] = {}
    expressions: dict[str, Any] = {}
    for name, value in controls.items():
        if name not in sizes:
            raise unknown_name_error(
                "control", name, f"the law of guess_from_simulation() for {phase.label}", sizes
            )
        what = f"the law of '{name}' for {phase.label}"
        if callable(value) and not isinstance(value, ca.SX):
            timed[name] = value
            continue
        if not isinstance(value, (ca.SX, list)):
            value = ca.SX(read_vector(value, sizes[name], what))
        expressions[name] = convert_to_sx_column(value, what, sizes[name], ProblemError)
    stacked = ca.vertcat(ca.SX(0, 1), *expressions.values())
    function = _compile_expression(problem, phase, stacked, "the law of guess_from_simulation()")
    ends = np.cumsum([sizes[name] for name in expressions], dtype=int)

    def evaluate_control_law(t: float, x: Array) -> Array:
        values = dict(zip(expressions, np.split(function(t, x), ends), strict=False))
        for name, signal in timed.items():
            values[name] = read_vector(signal(t), sizes[name], f"the law of '{name}' at t = {t:.4g} s")
        u = box.midpoint[:, None].copy()
        for name, value in values.items():
            set_control_guess(model, u, name, value[:, None])
        return np.clip(u[:, 0], box.lower, box.upper)

    return evaluate_control_law


def _build_simulation_stop_event(
    problem: Problem, phase: Phase, until: Any
) -> Callable[[float, Array], float]:
    what = "the until= expression of guess_from_simulation()"
    function = _compile_expression(problem, phase, convert_to_sx_column(until, what, 1, ProblemError), what)
    return lambda t, x: float(function(t, x)[0])


def _compile_expression(
    problem: Problem, phase: Phase, expression: Any, what: str
) -> Callable[[float, Array], Array]:
    """Return (t, x) -> values (n,) of an expression without controls, at the guessed parameters."""
    t, x, u, p = phase.model.symbolic_arguments()
    problem.check_foreign_symbols(phase, expression, what)
    if phase.model.controls.size and ca.depends_on(expression, u):
        raise ProblemError(f"{what} uses controls of {phase.label}: write it in time, states and parameters.")
    q = problem.parameter_symbols()
    function = ca.Function(
        "law", [t, x, p, q], [ca.densify(problem.substitute_parameters(phase, expression))]
    )
    return build_single_point_evaluator(function, phase.model.parameter_values, problem.get_parameter_guess())
