"""Mistakes in the declarations of a problem: each is refused by the call that makes it."""

from __future__ import annotations

import numpy as np
import pytest
from testing.models import dynamics
from testing.wrong_arguments import cart, refused, rest_to_rest, scalar, ship, voyage

import gnc_opt as go

# --- phases ---------------------------------------------------------------------------------------------


def test_phases_refused() -> None:
    with refused(go.ArgumentError, "name of a problem", "Model"):
        go.Problem(cart())

    problem = go.Problem("p")
    with refused(go.ArgumentError, "model of phase 'leg' of problem 'p'", "Problem", "phase(name, model)"):
        problem.phase("leg", problem)
    with refused(go.ProblemError, "Model('cart'", "cannot be the name of a phase", "give its name first"):
        go.Problem("p").phase(cart(), "leg")

    problem, model = go.Problem("p"), cart()
    problem.phase("leg", model)
    with refused(go.ProblemError, "problem 'p' has two phases 'leg'", "rename one"):
        problem.phase("leg", model)

    here, there = (go.Model(name) for name in ("here", "there"))
    vectors = [model.state("r", 2) for model in (here, there)]
    for model, r in zip((here, there), vectors, strict=True):
        model.ode({r: [1.0, 1.0]})
    with refused(
        go.ProblemError, "'r_0'", "not a symbol of model", "another model's", "write model.symbol('r')"
    ):
        go.Problem("p").phase("leg", here).path("wall", vectors[1][0], upper=1.0)
    with refused(
        go.ProblemError, "'leg[0]' cannot be the name of a phase of problem 'p'", "without brackets"
    ):
        go.Problem("p").phase("leg[0]", cart())
    with refused(go.ProblemError, "name of a phase of problem 'p'", "line breaks"):
        go.Problem("p").phase("first\nleg", cart())
    with refused(go.UnknownNameError, "problem 'rest to rest' has no phase 'lag'", "did you mean 'leg'?"):
        rest_to_rest()[0].with_initial("lag", q=2.0)
    with refused(
        go.ProblemError, "phase 'leg' of problem 'voyage' is not a phase of problem 'rest to rest'", "its own"
    ):
        rest_to_rest()[0].get_phase(voyage()[1])

    problem, model = go.Problem("p"), cart()
    problem.phase("a", model), problem.phase("b", model)
    with refused(go.ProblemError, "problem 'p' has 2 phases", "name one of ['a', 'b']"):
        problem.with_initial(q=1.0)


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


def test_times_refused() -> None:
    with refused(go.ProblemError, "final time of phase 'leg'", "lower limit 5 exceeds upper limit 2", "swap"):
        rest_to_rest()[1].time(initial=0.0, final=(5.0, 2.0))
    with refused(go.ProblemError, "final time of phase 'leg'", "NaN"):
        rest_to_rest()[1].time(initial=0.0, final=np.nan)
    with refused(go.ProblemError, "final time of phase 'leg'", "'ten seconds'", "not a number"):
        rest_to_rest()[1].time(initial=0.0, final="ten seconds")
    with refused(go.ProblemError, "initial time of phase 'leg'", "infinite", "None"):
        rest_to_rest()[1].time(initial=np.inf, final=None)
    with refused(go.ProblemError, "final time of phase 'leg'", "3 entries", "(lower, upper)"):
        rest_to_rest()[1].time(initial=0.0, final=(1.0, 2.0, 3.0))
    with refused(go.ProblemError, "duration of phase 'leg'", "positive"):
        rest_to_rest()[1].time(initial=0.0, final=None, duration=(-2.0, -1.0))
    with refused(go.UnknownNameError, "no time 'finl'", "did you mean 'final'?"):
        rest_to_rest()[0].with_time(finl=2.0)


def test_boundary_values_and_bounds_refused() -> None:
    with refused(
        go.UnknownNameError, "phase 'leg' of problem 'rest to rest' has no state 'vv'", "did you mean 'v'?"
    ):
        rest_to_rest()[1].initial(vv=0.0)
    with refused(go.ProblemError, "final value of control 'a'", "limit its rate before"):
        rest_to_rest()[1].final(a=0.0)
    with refused(
        go.ProblemError,
        "initial value of 'r' in phase 'leg' of problem 'voyage'",
        "2 values",
        "give 3 values",
    ):
        voyage()[1].initial(r=[1.0, 2.0])
    with refused(go.ProblemError, "final value of 'q'", "NaN", "None"):
        rest_to_rest()[1].final(q=np.nan)
    with refused(go.ProblemError, "initial value of 'r'", "'x'", "not a number"):
        voyage()[1].initial(r=[0.0, "x", None])
    with refused(go.ProblemError, "initial value of 'q'", "infinite"):
        rest_to_rest()[1].initial(q=-np.inf)
    with refused(go.ProblemError, "initial value of 'q'", "'1.0'", "not a number"):
        rest_to_rest()[1].initial(q="1.0")

    _, leg = rest_to_rest()
    with refused(go.ProblemError, "initial value of 'q'", "numbers are needed"):
        leg.initial(q=leg.model.symbol("v"))
    with refused(go.ProblemError, "final value of 'w' in phase 'leg'", "(1.0, 2.0)", "two ways", "[a, b]"):
        voyage()[1].final(w=(1.0, 2.0))
    with refused(go.ProblemError, "bounds of 'a' in phase 'leg'", ": lower limit 1 exceeds upper limit -1"):
        rest_to_rest()[1].bounds(a=(1.0, -1.0))
    with refused(go.ProblemError, "bounds of 'r'", "component 1", "lower limit 5"):
        voyage()[1].bounds(r=([0.0, 5.0, 0.0], [1.0, 1.0, 1.0]))
    with refused(go.ProblemError, "upper limit of the bounds of 'force'", "2 values", "give 3 values"):
        voyage()[1].bounds(force=(-1.0, [1.0, 2.0]))
    with refused(go.ProblemError, "bounds of 'a'", "upper limit NaN"):
        rest_to_rest()[1].bounds(a=(-1.0, np.nan))
    with refused(
        go.UnknownNameError, "bounds() of phase 'leg'", "no state or control 'forec'", "did you mean 'force'?"
    ):
        voyage()[1].bounds(forec=(-1.0, 1.0))
    with refused(
        go.ProblemError, "bounds() of phase 'leg'", "'mass'", "parameter of the model", "Problem.parameter()"
    ):
        voyage()[1].bounds(mass=(1.0, 2.0))


def test_none_in_a_list_leaves_a_component_free() -> None:
    _, leg = voyage()
    leg.initial(r=[0.0, None, 3.0])
    np.testing.assert_array_equal(leg.numbers.initial.lower[:3], [0.0, -np.inf, 3.0])
    np.testing.assert_array_equal(leg.numbers.initial.upper[:3], [0.0, np.inf, 3.0])
    leg.bounds(tilt=([None, -2.0], [1.0, None]))
    np.testing.assert_array_equal(leg.numbers.controls.lower[3:], [-np.inf, -2.0])
    np.testing.assert_array_equal(leg.numbers.controls.upper[3:], [1.0, np.inf])


def test_pairs_for_a_vector_of_two_that_are_clear() -> None:
    _, leg = voyage()
    leg.initial(w=[1.0, 2.0])
    leg.final(w=([0.0, 1.0], [2.0, 3.0]))
    leg.bounds(tilt=([-1.0, -2.0], 3.0))
    np.testing.assert_array_equal(leg.numbers.initial.lower[3:], [1.0, 2.0])
    np.testing.assert_array_equal(leg.numbers.final.upper[3:], [2.0, 3.0])
    np.testing.assert_array_equal(leg.numbers.controls.upper[3:], [3.0, 3.0])


def test_path_constraints_integrals_refused() -> None:
    _, leg = rest_to_rest()
    leg.path("fast", leg.model.symbol("v"), upper=1.0)
    with refused(
        go.ProblemError, "phase 'leg' of problem 'rest to rest' has two path constraints 'fast'", "rename"
    ):
        leg.path("fast", leg.model.symbol("v"), lower=-1.0)

    _, leg = rest_to_rest()
    with refused(go.ProblemError, "path constraint 'fast'", "no limit", "lower, upper or equals"):
        leg.path("fast", leg.model.symbol("v"))
    with refused(go.ProblemError, "path constraint 'fast'", "both equals and lower/upper"):
        leg.path("fast", leg.model.symbol("v"), upper=1.0, equals=0.0)
    with refused(go.ProblemError, "path constraint 'fast'", "lower limit 2", "upper limit 1"):
        leg.path("fast", leg.model.symbol("v"), lower=2.0, upper=1.0)

    _, leg = voyage()
    with refused(go.ProblemError, "path constraint 'near'", "2 values", "give 3 values"):
        leg.path("near", leg.model.symbol("r"), upper=[1.0, 2.0])

    _, leg = rest_to_rest()
    with refused(go.ProblemError, "path constraint 'end'", "end-point symbol 'leg_final_q'", "constrain()"):
        leg.path("end", leg.final_state("q") - leg.model.symbol("q"), upper=1.0)
    with refused(go.ProblemError, "path constraint 'foreign'", "uses 'w_0'", "model 'cart'"):
        leg.path("foreign", ship().symbol("w")[0], upper=1.0)
    with refused(
        go.ProblemError, "cannot be the name of a path constraint of phase 'leg'", "give its name first"
    ):
        leg.path(leg.model.symbol("v") <= 1.0)

    problem, leg = rest_to_rest()
    with refused(
        go.ProblemError,
        "cannot be the name of a constraint of problem 'rest to rest'",
        "give its name first",
    ):
        problem.constrain(leg.final_time <= 3.0)

    _, leg = rest_to_rest()
    with refused(
        go.ProblemError, "cannot be the name of an integral of phase 'leg'", 'integral(expression, "name")'
    ):
        leg.integral("effort", leg.model.symbol("a") ** 2)
    with refused(go.ProblemError, "the size of parameter 'fuel'", "write lower=..., upper=... for bounds"):
        rest_to_rest()[0].parameter("fuel", (5.0, 200.0))
    with refused(
        go.ProblemError, "path constraint 'fast' of phase 'leg'", "None", "build it from the symbols"
    ):
        leg.path("fast", upper=1.0)
    with refused(go.ProblemError, "cannot be the name of a path constraint of phase 'leg'", "text"):
        leg.path(leg.model.symbol("v"), 1.0, upper=1.0)
    with refused(go.ProblemError, "two integrals 'effort'", "rename"):
        leg.integral(leg.model.symbol("a") ** 2, name="effort")

    _, leg = voyage()
    with refused(go.ProblemError, "integral 'effort'", "3 components", "give 1"):
        leg.integral(leg.model.symbol("force"), name="effort")

    _, leg = rest_to_rest()
    with refused(go.ProblemError, "integral 'integral_2'", "end-point symbol 'leg_final_time'"):
        leg.integral(leg.final_time)
    with refused(go.UnknownNameError, "phase 'leg'", "no state 'qq'", "did you mean 'q'?"):
        rest_to_rest()[1].final_state("qq")


def test_cost_boundary_constraints_links_parameters_refused() -> None:
    problem, leg = rest_to_rest()
    with refused(go.ProblemError, "problem 'rest to rest' has two costs", "keep one"):
        problem.maximize(leg.final_time)

    model, problem, _ = scalar()
    with refused(
        go.ProblemError,
        "cost of problem 'decay' uses 'u'",
        "along phase 'leg'",
        "leg.integral(...)",
        "final_state",
    ):
        problem.minimize(model.symbol("u") ** 2)
    with refused(go.ProblemError, "cost of problem 'decay' uses 'q'", "not a symbol of this problem"):
        scalar()[1].minimize(cart().symbol("q"))

    problem, leg = voyage()
    with refused(go.ProblemError, "cost of problem 'voyage'", "3 components", "give 1"):
        problem.minimize(leg.final_state("r"))

    problem, leg = rest_to_rest()
    with refused(go.ProblemError, "constraint 'meet'", "uses 'v'", "leg.initial_state(...)"):
        problem.constrain("meet", leg.model.symbol("v"), equals=0.0)

    problem, leg = rest_to_rest()
    problem.constrain("meet", leg.final_state("q"), upper=1.0)
    with refused(go.ProblemError, "problem 'rest to rest' has two constraints 'meet'", "rename"):
        problem.constrain("meet", leg.final_state("v"), upper=1.0)

    problem, leg = rest_to_rest()
    with refused(go.ProblemError, "'meet[0]' cannot be the name of a constraint", "brackets"):
        problem.constrain("meet[0]", leg.final_state("q"), upper=1.0)

    problem, boost, coast = _two_legs()
    with refused(
        go.ProblemError,
        "link_boost_coast of problem 'mission'",
        "'r' of 3 components to one of 2",
        "states=[...]",
    ):
        problem.link(boost, coast)
    with refused(go.UnknownNameError, "phase 'coast' of problem 'mission' has no state 'w'", "known: r"):
        problem.link(boost, coast, states=["w"])

    problem, boost, _ = _two_legs()
    with refused(go.UnknownNameError, "problem 'mission' has no phase 'cost'", "did you mean 'coast'?"):
        problem.link(boost, "cost")

    problem, boost, coast = _two_legs()
    with refused(go.ProblemError, "states of link_boost_coast", "'w'", "list of names"):
        problem.link(boost, coast, states="w")

    problem, boost, _ = _two_legs()
    again = problem.phase("again", boost.model)
    with refused(go.ProblemError, "jump of 'w' in link_boost_again", "3 values", "give 2 values"):
        problem.link(boost, again, jump={"w": [1.0, 2.0, 3.0]})

    problem, leg = rest_to_rest()
    with refused(go.ProblemError, "link_leg_leg of problem 'rest to rest'", "time=False"):
        problem.link(leg, leg)

    problem, _ = rest_to_rest()
    problem.parameter("k")
    with refused(go.ProblemError, "two parameters 'k'", "rename"):
        problem.parameter("k")
    with refused(
        go.ProblemError, "parameter 'mass' of problem 'voyage' has 3 components", "model 'ship' it has 1"
    ):
        voyage()[0].parameter("mass", 3)
    with refused(
        go.ProblemError, "parameter 'k' of problem 'rest to rest'", "lower limit 2", "upper limit 1"
    ):
        rest_to_rest()[0].parameter("k", lower=2.0, upper=1.0)
    with refused(go.ProblemError, "guess of parameter 'k'", "finite"):
        rest_to_rest()[0].parameter("k", guess=np.inf)
    with refused(
        go.UnknownNameError, "problem 'voyage' has no model parameter 'mas'", "did you mean 'mass'?"
    ):
        voyage()[0].with_parameters(mas=1.0)


def _two_legs() -> tuple[go.Problem, go.Phase, go.Phase]:
    small, _r, _u = dynamics("small", "r:2", "u:2", lambda r, u: {r: u})
    problem = go.Problem("mission")
    return problem, problem.phase("boost", ship()), problem.phase("coast", small)


def test_guesses_and_scales_refused() -> None:
    with refused(go.UnknownNameError, "guess() of phase 'leg'", "'qq'", "did you mean 'q'?"):
        rest_to_rest()[1].guess(qq=1.0)
    with refused(go.ProblemError, "times of the guess in phase 'leg'", "increase"):
        rest_to_rest()[1].guess(time=[0.0, 2.0, 1.0], q=[0.0, 1.0, 2.0])
    with refused(go.ProblemError, "guess of 'q' in phase 'leg'", "(4,)", "give (1, 3) for 3 guess times"):
        rest_to_rest()[1].guess(time=[0.0, 1.0, 2.0], q=[0.0, 1.0, 2.0, 3.0])
    with refused(go.ProblemError, "guess of 'r' in phase 'leg'", "(2, 3)", "give (3, 3)"):
        voyage()[1].guess(time=[0.0, 1.0, 2.0], r=np.zeros((2, 3)))
    with refused(go.ProblemError, "guess of 'q' in phase 'leg'", "no times", "guess(time=[...], ...)"):
        rest_to_rest()[1].guess(q=[0.0, 1.0, 2.0, 3.0])
    with refused(go.ProblemError, "guess of 'q' in phase 'leg'", "3 entries", "(start, end)"):
        rest_to_rest()[1].guess(q=(0.0, 1.0, 2.0))
    with refused(go.ProblemError, "guess of 'w' in phase 'leg'", "(0.0, 1.0)", "two ways"):
        voyage()[1].guess(w=(0.0, 1.0))
    with refused(go.ProblemError, "guess of 'q' in phase 'leg'", "nan", "finite"):
        rest_to_rest()[1].guess(time=[0.0, 1.0], q=[np.nan, 1.0])
    with refused(go.ProblemError, "guess of 'q' in phase 'leg'", "'left'", "not a number"):
        rest_to_rest()[1].guess(q="left")
    with refused(go.ProblemError, "scale of 'q' in phase 'leg'", "positive"):
        rest_to_rest()[1].scale(q=-1.0)
    with refused(go.UnknownNameError, "scale() of phase 'leg'", "did you mean 'force'?"):
        voyage()[1].scale(forces=1.0)
