"""Mistakes in the declarations of a problem: each is refused by the call that makes it."""

from __future__ import annotations

import numpy as np
import pytest
from testing.wrong_arguments import cart, mistake, rest_to_rest, scalar, ship, voyage

import gnc_opt as go

# --- phases ---------------------------------------------------------------------------------------------


@mistake(go.ArgumentError, "name of a problem", "Model")
def test_problem_made_from_a_model() -> None:
    go.Problem(cart())  # type: ignore[arg-type]  # wrong


@mistake(go.ArgumentError, "model of phase 'leg' of problem 'p'", "Problem", "phase(name, model)")
def test_phase_without_a_model() -> None:
    problem = go.Problem("p")
    problem.phase("leg", problem)  # type: ignore[arg-type]  # wrong


@mistake(go.ProblemError, "Model('cart'", "cannot be the name of a phase", "its name comes first")
def test_phase_arguments_swapped() -> None:
    go.Problem("p").phase(cart(), "leg")  # type: ignore[arg-type]  # wrong


@mistake(go.ProblemError, "problem 'p' has two phases 'leg'", "rename one")
def test_duplicate_phase() -> None:
    problem, model = go.Problem("p"), cart()
    problem.phase("leg", model)
    problem.phase("leg", model)  # wrong


@mistake(go.ProblemError, "'r_0'", "no symbol of model", "another model's", "write model.symbol('r')")
def test_a_path_in_the_symbols_of_another_model() -> None:
    here, there = (go.Model(name) for name in ("here", "there"))
    vectors = [model.state("r", 2) for model in (here, there)]
    for model, r in zip((here, there), vectors, strict=True):
        model.ode({r: [1.0, 1.0]})
    go.Problem("p").phase("leg", here).path("wall", vectors[1][0], upper=1.0)  # wrong


@mistake(go.ProblemError, "'leg[0]' cannot be the name of a phase of problem 'p'", "without brackets")
def test_phase_name_with_brackets() -> None:
    go.Problem("p").phase("leg[0]", cart())  # wrong


def test_two_phases_may_share_a_model() -> None:
    problem, model = go.Problem("p"), cart()
    legs = [problem.phase(name, model) for name in ("out", "back")]
    for start, leg in enumerate(legs):
        leg.time(float(start), start + 1.0)
        leg.bounds(a=(-9.0, 9.0))
    legs[0].initial(q=0.0, v=0.0)
    legs[1].final(q=1.0, v=0.0)
    problem.link(*legs)
    problem.minimize(sum(leg.integral(model.symbol("a") ** 2) for leg in legs))
    assert go.solve(problem, mesh="4x3", tol=None).objective == pytest.approx(
        12.0 / 2.0**3, rel=1e-6
    )  # 12 d^2 / T^3


def test_two_phases_may_share_a_model_with_parameters() -> None:
    problem, model = go.Problem("p"), ship()
    legs = [problem.phase(name, model) for name in ("out", "back")]
    for start, leg in enumerate(legs):
        leg.time(float(start), start + 1.0)
        leg.bounds(tilt=0.0)
    legs[0].initial(r=0.0, w=0.0)
    legs[1].final(r=1.0)
    problem.link(*legs)
    force = model.symbol("force")
    problem.minimize(sum(leg.integral(force.T @ force) for leg in legs) * model.symbol("mass"))
    # r' = force / mass over 2 s: the force is mass / 2 in three axes, the cost mass * 2 * 3 (mass / 2)^2.
    assert go.solve(problem, mesh="2x3", tol=None).objective == pytest.approx(12.0, rel=1e-9)


@mistake(go.UnknownNameError, "problem 'rest to rest' has no phase 'lag'", "did you mean 'leg'?")
def test_unknown_phase() -> None:
    rest_to_rest()[0].with_initial("lag", q=2.0)  # wrong


@mistake(
    go.ProblemError, "phase 'leg' of problem 'voyage' is not a phase of problem 'rest to rest'", "its own"
)
def test_phase_of_another_problem() -> None:
    rest_to_rest()[0].get_phase(voyage()[1])  # wrong


@mistake(go.ProblemError, "problem 'p' has 2 phases", "name one of ['a', 'b']")
def test_phase_left_out_where_there_are_two() -> None:
    problem, model = go.Problem("p"), cart()
    problem.phase("a", model), problem.phase("b", model)
    problem.with_initial(q=1.0)  # wrong


# --- times ----------------------------------------------------------------------------------------------


@mistake(go.ProblemError, "final time of phase 'leg'", "lower limit 5", "upper limit 2", "swap")
def test_crossed_range_of_the_final_time() -> None:
    rest_to_rest()[1].time(initial=0.0, final=(5.0, 2.0))  # wrong


@mistake(go.ProblemError, "final time of phase 'leg'", "NaN")
def test_nan_as_time() -> None:
    rest_to_rest()[1].time(initial=0.0, final=np.nan)  # wrong


@mistake(go.ProblemError, "final time of phase 'leg'", "'ten seconds'", "not a number")
def test_text_as_time() -> None:
    rest_to_rest()[1].time(initial=0.0, final="ten seconds")  # wrong


@mistake(go.ProblemError, "initial time of phase 'leg'", "infinity", "None")
def test_infinite_time() -> None:
    rest_to_rest()[1].time(initial=np.inf, final=None)  # wrong


@mistake(go.ProblemError, "final time of phase 'leg'", "3 entries", "(lower, upper)")
def test_tuple_of_three_times() -> None:
    rest_to_rest()[1].time(initial=0.0, final=(1.0, 2.0, 3.0))  # wrong


@mistake(go.ProblemError, "duration of phase 'leg'", "positive")
def test_negative_duration() -> None:
    rest_to_rest()[1].time(initial=0.0, final=None, duration=(-2.0, -1.0))  # wrong


@mistake(go.UnknownNameError, "no time 'finl'", "did you mean 'final'?")
def test_misspelt_time_of_a_variation() -> None:
    rest_to_rest()[0].with_time(finl=2.0)  # wrong


# --- boundary values and bounds -------------------------------------------------------------------------


@mistake(go.UnknownNameError, "phase 'leg' of problem 'rest to rest' has no state 'vv'", "did you mean 'v'?")
def test_initial_value_of_an_unknown_state() -> None:
    rest_to_rest()[1].initial(vv=0.0)  # wrong


@mistake(go.ProblemError, "final value of control 'a'", "limit its rate before")
def test_final_value_of_a_control() -> None:
    rest_to_rest()[1].final(a=0.0)  # wrong


@mistake(
    go.ProblemError, "initial value of 'r' in phase 'leg' of problem 'voyage'", "2 values", "give 3 values"
)
def test_initial_value_of_the_wrong_size() -> None:
    voyage()[1].initial(r=[1.0, 2.0])  # wrong


@mistake(go.ProblemError, "final value of 'q'", "NaN", "None")
def test_nan_as_final_value() -> None:
    rest_to_rest()[1].final(q=np.nan)  # wrong


@mistake(go.ProblemError, "initial value of 'r'", "'x'", "not a number")
def test_value_with_text() -> None:
    voyage()[1].initial(r=[0.0, "x", None])  # wrong


def test_none_in_a_list_leaves_a_component_free() -> None:
    _, leg = voyage()
    leg.initial(r=[0.0, None, 3.0])
    np.testing.assert_array_equal(leg.numbers.initial.lower[:3], [0.0, -np.inf, 3.0])
    np.testing.assert_array_equal(leg.numbers.initial.upper[:3], [0.0, np.inf, 3.0])
    leg.bounds(tilt=([None, -2.0], [1.0, None]))
    np.testing.assert_array_equal(leg.numbers.controls.lower[3:], [-np.inf, -2.0])
    np.testing.assert_array_equal(leg.numbers.controls.upper[3:], [1.0, np.inf])


@mistake(go.ProblemError, "initial value of 'q'", "infinity")
def test_infinite_initial_value() -> None:
    rest_to_rest()[1].initial(q=-np.inf)  # wrong


@mistake(go.ProblemError, "initial value of 'q'", "'1.0'", "not a number")
def test_number_as_text() -> None:
    rest_to_rest()[1].initial(q="1.0")  # wrong


@mistake(go.ProblemError, "initial value of 'q'", "numbers are needed")
def test_symbol_as_initial_value() -> None:
    _, leg = rest_to_rest()
    leg.initial(q=leg.model.symbol("v"))  # wrong


@mistake(go.ProblemError, "final value of 'w' in phase 'leg'", "(1.0, 2.0)", "two ways", "[a, b]")
def test_ambiguous_pair_for_a_vector_of_two() -> None:
    voyage()[1].final(w=(1.0, 2.0))  # wrong


def test_pairs_for_a_vector_of_two_that_are_clear() -> None:
    _, leg = voyage()
    leg.initial(w=[1.0, 2.0])
    leg.final(w=([0.0, 1.0], [2.0, 3.0]))
    leg.bounds(tilt=([-1.0, -2.0], 3.0))
    np.testing.assert_array_equal(leg.numbers.initial.lower[3:], [1.0, 2.0])
    np.testing.assert_array_equal(leg.numbers.final.upper[3:], [2.0, 3.0])
    np.testing.assert_array_equal(leg.numbers.controls.upper[3:], [3.0, 3.0])


@mistake(go.ProblemError, "bounds of 'a' in phase 'leg'", "lower limit 1", "upper limit -1", "swap")
def test_crossed_bounds() -> None:
    rest_to_rest()[1].bounds(a=(1.0, -1.0))  # wrong


@mistake(go.ProblemError, "bounds of 'r'", "component 1", "lower limit 5")
def test_crossed_bounds_of_one_component() -> None:
    voyage()[1].bounds(r=([0.0, 5.0, 0.0], [1.0, 1.0, 1.0]))  # wrong


@mistake(go.ProblemError, "upper limit of the bounds of 'force'", "2 values", "give 3 values")
def test_bounds_of_the_wrong_size() -> None:
    voyage()[1].bounds(force=(-1.0, [1.0, 2.0]))  # wrong


@mistake(go.ProblemError, "bounds of 'a'", "upper limit NaN")
def test_nan_as_bound() -> None:
    rest_to_rest()[1].bounds(a=(-1.0, np.nan))  # wrong


@mistake(
    go.UnknownNameError, "bounds() of phase 'leg'", "no state or control 'forec'", "did you mean 'force'?"
)
def test_bounds_of_an_unknown_name() -> None:
    voyage()[1].bounds(forec=(-1.0, 1.0))  # wrong


@mistake(
    go.ProblemError, "bounds() of phase 'leg'", "'mass'", "parameter of the model", "Problem.parameter()"
)
def test_bounds_of_a_parameter() -> None:
    voyage()[1].bounds(mass=(1.0, 2.0))  # wrong


# --- path constraints, integrals ------------------------------------------------------------------------


@mistake(go.ProblemError, "phase 'leg' of problem 'rest to rest' has two path constraints 'fast'", "rename")
def test_duplicate_path_constraint() -> None:
    _, leg = rest_to_rest()
    leg.path("fast", leg.model.symbol("v"), upper=1.0)
    leg.path("fast", leg.model.symbol("v"), lower=-1.0)  # wrong


@mistake(go.ProblemError, "path constraint 'fast'", "no limit", "lower, upper or equals")
def test_path_constraint_without_a_limit() -> None:
    _, leg = rest_to_rest()
    leg.path("fast", leg.model.symbol("v"))  # wrong


@mistake(go.ProblemError, "path constraint 'fast'", "both equals and lower/upper")
def test_path_constraint_with_too_many_limits() -> None:
    _, leg = rest_to_rest()
    leg.path("fast", leg.model.symbol("v"), upper=1.0, equals=0.0)  # wrong


@mistake(go.ProblemError, "path constraint 'fast'", "lower limit 2", "upper limit 1")
def test_crossed_path_constraint() -> None:
    _, leg = rest_to_rest()
    leg.path("fast", leg.model.symbol("v"), lower=2.0, upper=1.0)  # wrong


@mistake(go.ProblemError, "path constraint 'near'", "2 values", "give 3 values")
def test_limit_of_the_wrong_size() -> None:
    _, leg = voyage()
    leg.path("near", leg.model.symbol("r"), upper=[1.0, 2.0])  # wrong


@mistake(go.ProblemError, "path constraint 'end'", "end-point symbol 'leg_final_q'", "constrain()")
def test_path_constraint_with_an_end_point() -> None:
    _, leg = rest_to_rest()
    leg.path("end", leg.final_state("q") - leg.model.symbol("q"), upper=1.0)  # wrong


@mistake(go.ProblemError, "path constraint 'foreign'", "uses 'w_0'", "model 'cart'")
def test_path_constraint_with_a_foreign_symbol() -> None:
    _, leg = rest_to_rest()
    leg.path("foreign", ship().symbol("w")[0], upper=1.0)  # wrong


@mistake(go.ProblemError, "cannot be the name of a path constraint of phase 'leg'", "its name comes first")
def test_inequality_where_the_name_of_a_path_constraint_belongs() -> None:
    _, leg = rest_to_rest()
    leg.path(leg.model.symbol("v") <= 1.0)  # type: ignore[arg-type]  # wrong


@mistake(
    go.ProblemError, "cannot be the name of a constraint of problem 'rest to rest'", "its name comes first"
)
def test_constraint_without_a_name() -> None:
    problem, leg = rest_to_rest()
    problem.constrain(leg.final_time <= 3.0)  # wrong


@mistake(go.ProblemError, "cannot be the name of an integral of phase 'leg'", 'integral(expression, "name")')
def test_name_of_an_integral_first() -> None:
    _, leg = rest_to_rest()
    leg.integral("effort", leg.model.symbol("a") ** 2)  # type: ignore[arg-type]  # wrong


@mistake(go.ProblemError, "the size of parameter 'fuel'", "write lower=..., upper=... for bounds")
def test_bounds_in_place_of_a_size() -> None:
    rest_to_rest()[0].parameter("fuel", (5.0, 200.0))  # type: ignore[arg-type]  # wrong


@mistake(go.ProblemError, "path constraint 'fast' of phase 'leg'", "None", "build it from the symbols")
def test_path_constraint_without_an_expression() -> None:
    _, leg = rest_to_rest()
    leg.path("fast", upper=1.0)  # wrong


@mistake(go.ProblemError, "cannot be the name of a path constraint of phase 'leg'", "text")
def test_path_constraint_without_a_name() -> None:
    _, leg = rest_to_rest()
    leg.path(leg.model.symbol("v"), 1.0, upper=1.0)  # type: ignore[arg-type]  # wrong


@mistake(go.ProblemError, "two integrals 'effort'", "rename")
def test_duplicate_integral() -> None:
    _, leg = rest_to_rest()
    leg.integral(leg.model.symbol("a") ** 2, name="effort")  # wrong


@mistake(go.ProblemError, "integral 'effort'", "3 components", "give 1")
def test_integral_of_a_vector() -> None:
    _, leg = voyage()
    leg.integral(leg.model.symbol("force"), name="effort")  # wrong


@mistake(go.ProblemError, "integral 'integral_2'", "end-point symbol 'leg_final_time'")
def test_integral_of_an_end_point() -> None:
    _, leg = rest_to_rest()
    leg.integral(leg.final_time)  # wrong


@mistake(go.UnknownNameError, "phase 'leg'", "no state 'qq'", "did you mean 'q'?")
def test_end_point_of_an_unknown_state() -> None:
    rest_to_rest()[1].final_state("qq")  # wrong


# --- cost, boundary constraints, links, parameters ------------------------------------------------------


@mistake(go.ProblemError, "problem 'rest to rest' has two costs", "keep one")
def test_two_costs() -> None:
    problem, leg = rest_to_rest()
    problem.maximize(leg.final_time)  # wrong


@mistake(
    go.ProblemError,
    "cost of problem 'decay' uses 'u'",
    "along phase 'leg'",
    "leg.integral(...)",
    "final_state",
)
def test_running_symbol_in_the_cost() -> None:
    model, problem, _ = scalar()
    problem.minimize(model.symbol("u") ** 2)  # wrong


@mistake(go.ProblemError, "cost of problem 'decay' uses 'q'", "no phase of this problem")
def test_foreign_symbol_in_the_cost() -> None:
    scalar()[1].minimize(cart().symbol("q"))  # wrong


@mistake(go.ProblemError, "cost of problem 'voyage'", "3 components", "give 1")
def test_vector_as_cost() -> None:
    problem, leg = voyage()
    problem.minimize(leg.final_state("r"))  # wrong


@mistake(go.ProblemError, "constraint 'meet'", "uses 'v'", "leg.initial_state(...)")
def test_running_symbol_in_a_boundary_constraint() -> None:
    problem, leg = rest_to_rest()
    problem.constrain("meet", leg.model.symbol("v"), equals=0.0)  # wrong


@mistake(go.ProblemError, "problem 'rest to rest' has two constraints 'meet'", "rename")
def test_duplicate_boundary_constraint() -> None:
    problem, leg = rest_to_rest()
    problem.constrain("meet", leg.final_state("q"), upper=1.0)
    problem.constrain("meet", leg.final_state("v"), upper=1.0)  # wrong


@mistake(go.ProblemError, "'meet[0]' cannot be the name of a constraint", "brackets")
def test_constraint_name_with_brackets() -> None:
    problem, leg = rest_to_rest()
    problem.constrain("meet[0]", leg.final_state("q"), upper=1.0)  # wrong


def _two_legs() -> tuple[go.Problem, go.Phase, go.Phase]:
    small = go.Model("small")
    r, u = small.state("r", 2), small.control("u", 2)
    small.ode({r: u})
    problem = go.Problem("mission")
    return problem, problem.phase("boost", ship()), problem.phase("coast", small)


@mistake(
    go.ProblemError,
    "link_boost_coast of problem 'mission'",
    "'r' of 3 components to one of 2",
    "states=[...]",
)
def test_link_of_states_that_differ_in_size() -> None:
    problem, boost, coast = _two_legs()
    problem.link(boost, coast)  # wrong


@mistake(go.UnknownNameError, "phase 'coast' of problem 'mission' has no state 'w'", "known: r")
def test_link_of_a_state_that_one_side_lacks() -> None:
    problem, boost, coast = _two_legs()
    problem.link(boost, coast, states=["w"])  # wrong


@mistake(go.UnknownNameError, "problem 'mission' has no phase 'cost'", "did you mean 'coast'?")
def test_link_to_an_unknown_phase() -> None:
    problem, boost, _ = _two_legs()
    problem.link(boost, "cost")  # wrong


@mistake(go.ProblemError, "states of link_boost_coast", "'w'", "list of names")
def test_link_states_as_one_text() -> None:
    problem, boost, coast = _two_legs()
    problem.link(boost, coast, states="w")  # wrong


@mistake(go.ProblemError, "jump of 'w' in link_boost_again", "3 values", "give 2 values")
def test_jump_of_the_wrong_size() -> None:
    problem, boost, _ = _two_legs()
    again = problem.phase("again", boost.model)
    problem.link(boost, again, jump={"w": [1.0, 2.0, 3.0]})  # wrong


@mistake(go.ProblemError, "link_leg_leg of problem 'rest to rest'", "time=False")
def test_link_of_a_phase_to_itself() -> None:
    problem, leg = rest_to_rest()
    problem.link(leg, leg)  # wrong


@mistake(go.ProblemError, "two parameters 'k'", "rename")
def test_duplicate_parameter() -> None:
    problem, _ = rest_to_rest()
    problem.parameter("k")
    problem.parameter("k")  # wrong


@mistake(go.ProblemError, "parameter 'mass' of problem 'voyage' has 3 components", "model 'ship' it has 1")
def test_free_parameter_that_differs_in_size_from_the_models() -> None:
    voyage()[0].parameter("mass", 3)  # wrong


@mistake(go.ProblemError, "parameter 'k' of problem 'rest to rest'", "lower limit 2", "upper limit 1")
def test_crossed_bounds_of_a_parameter() -> None:
    rest_to_rest()[0].parameter("k", lower=2.0, upper=1.0)  # wrong


@mistake(go.ProblemError, "guess of parameter 'k'", "finite")
def test_parameter_guess_that_is_not_finite() -> None:
    rest_to_rest()[0].parameter("k", guess=np.inf)  # wrong


@mistake(go.UnknownNameError, "problem 'voyage' has no model parameter 'mas'", "did you mean 'mass'?")
def test_misspelt_parameter_of_a_variation() -> None:
    voyage()[0].with_parameters(mas=1.0)  # wrong


# --- guesses and scales ---------------------------------------------------------------------------------


@mistake(go.UnknownNameError, "guess() of phase 'leg'", "'qq'", "did you mean 'q'?")
def test_guess_of_an_unknown_name() -> None:
    rest_to_rest()[1].guess(qq=1.0)  # wrong


@mistake(go.ProblemError, "times of the guess in phase 'leg'", "increase")
def test_guess_at_times_that_do_not_increase() -> None:
    rest_to_rest()[1].guess(time=[0.0, 2.0, 1.0], q=[0.0, 1.0, 2.0])  # wrong


@mistake(go.ProblemError, "guess of 'q' in phase 'leg'", "(4,)", "3 guess times give (1, 3)")
def test_guess_with_another_number_of_times() -> None:
    rest_to_rest()[1].guess(time=[0.0, 1.0, 2.0], q=[0.0, 1.0, 2.0, 3.0])  # wrong


@mistake(go.ProblemError, "guess of 'r' in phase 'leg'", "(2, 3)", "give (3, 3)")
def test_guess_with_another_number_of_components() -> None:
    voyage()[1].guess(time=[0.0, 1.0, 2.0], r=np.zeros((2, 3)))  # wrong


@mistake(go.ProblemError, "guess of 'q' in phase 'leg'", "no times", "guess(time=[...], ...)")
def test_guess_without_times() -> None:
    rest_to_rest()[1].guess(q=[0.0, 1.0, 2.0, 3.0])  # wrong


@mistake(go.ProblemError, "guess of 'q' in phase 'leg'", "3 entries", "(start, end)")
def test_guess_as_a_tuple_of_three() -> None:
    rest_to_rest()[1].guess(q=(0.0, 1.0, 2.0))  # wrong


@mistake(go.ProblemError, "guess of 'w' in phase 'leg'", "(0.0, 1.0)", "two ways")
def test_guess_as_an_ambiguous_pair() -> None:
    voyage()[1].guess(w=(0.0, 1.0))  # wrong


@mistake(go.ProblemError, "guess of 'q' in phase 'leg'", "nan", "finite")
def test_guess_with_nan() -> None:
    rest_to_rest()[1].guess(time=[0.0, 1.0], q=[np.nan, 1.0])  # wrong


@mistake(go.ProblemError, "guess of 'q' in phase 'leg'", "'left'", "not a number")
def test_guess_as_text() -> None:
    rest_to_rest()[1].guess(q="left")  # wrong


@mistake(go.ProblemError, "scale of 'q' in phase 'leg'", "positive")
def test_negative_scale() -> None:
    rest_to_rest()[1].scale(q=-1.0)  # wrong


@mistake(go.UnknownNameError, "scale() of phase 'leg'", "did you mean 'force'?")
def test_scale_of_an_unknown_name() -> None:
    voyage()[1].scale(forces=1.0)  # wrong
