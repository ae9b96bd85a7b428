"""Guesses by flying, from data and from solutions of other problems."""

from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.internals import build_phase_guess, guess_simulation, with_curved_guess, with_simulated_guess
from testing.models import dynamics, one_phase

import gnc_opt as go

FRACTIONS = np.linspace(0.0, 1.0, 11)


def spiral(model: go.Model | None = None) -> go.Problem:
    """Planar motion about a point mass (mu = 1) from the unit circle, thrust per mass u, |u| <= 0.01."""
    model = model or go.Model("spiral")
    r, v = model.state("r", 2), model.state("v", 2)
    u = model.control("u", 2)
    model.ode({r: v, v: -r / ca.norm_2(r) ** 3 + u})
    problem, leg = one_phase("spiral", model, 0.0, (1.0, 200.0), name="burn")
    leg.initial(r=[1.0, 0.0], v=[0.0, 1.0])
    leg.bounds(u=([-0.01, -0.01], [0.01, 0.01]))
    problem.minimize(leg.final_time)
    return problem


def along_velocity(problem: go.Problem, thrust: float) -> dict[str, Any]:
    v = problem.phases["burn"].model.symbol("v")
    return {"u": thrust * v / ca.norm_2(v)}


def guessed(problem: go.Problem, phase: str = "burn") -> Any:
    return build_phase_guess(problem.phases[phase], FRACTIONS)


def test_a_coast_is_keplers() -> None:
    """Without thrust the unit circle is flown: r = (cos t, sin t)."""
    start = guessed(go.guess_from_simulation(spiral(), {"u": 0.0}, duration=20.0))
    assert start.times == pytest.approx([0.0, 20.0])
    t = 20.0 * FRACTIONS
    np.testing.assert_allclose(
        start.states[:2], [np.cos(t), np.sin(t)], atol=2e-4
    )  # lines between 1001 points
    np.testing.assert_array_equal(start.controls, 0.0)


def test_tangential_thrust_spirals_out_until_a_radius() -> None:
    """Energy of a slow tangential spiral: d(1/a)/dt = -2 thrust v, nearly circular: t = (1 - 1 / sqrt(a)) / thrust."""
    problem, thrust = spiral(), 1e-3
    r, v = (problem.phases["burn"].model.symbol(name) for name in "rv")
    a = 1 / (2 / ca.norm_2(r) - ca.dot(v, v))
    flown = go.guess_from_simulation(
        problem, along_velocity(problem, thrust), duration=1000.0, until=a - 1.15
    )
    start = guessed(flown)
    last = start.states[:, -1]
    assert 1 / (2 / np.linalg.norm(last[:2]) - last[2:] @ last[2:]) == pytest.approx(1.15, abs=1e-6)
    assert start.times[1] == pytest.approx((1 - 1 / np.sqrt(1.15)) / thrust, rel=1e-2)
    parallel = start.controls[0] * start.states[3] - start.controls[1] * start.states[2]
    np.testing.assert_allclose(parallel, 0.0, atol=1e-6)


def test_laws_are_expressions_numbers_and_functions_of_time_within_bounds() -> None:
    for law, wanted in (
        ({"u": [0.005, -0.002]}, [0.005, -0.002]),
        ({"u": lambda t: [t / 1e4, 1.0]}, [0.0005, 0.01]),
        ({"u": 1.0}, [0.01, 0.01]),
        ({}, [0.0, 0.0]),
    ):
        start = guessed(go.guess_from_simulation(spiral(), law, duration=10.0))
        np.testing.assert_allclose(start.controls[:, 5], wanted, atol=1e-12)


def pushed(*, plain: bool = False) -> go.Problem:
    """A point mass with a thrust vector, |T| <= 2, and a split torque, |q| <= 1; or with plain controls."""
    model = go.Model("pushed")
    v, w = model.state("v", 2), model.state("w")
    T = model.control("T", 2) if plain else model.vector_control("T", 2)[0]
    q = model.control("q") if plain else model.split_control("q")[0]
    model.ode({v: T, w: q})
    problem, leg = one_phase("pushed", model, 0.0, 1.0, name="burn")
    leg.initial(v=[0.0, 0.0], w=0.0)
    if not plain:
        leg.norm_bounds(T=(0.0, 2.0))
        leg.bounds(q=(-1.0, 1.0))
    problem.minimize(leg.integral(ca.sumsqr(T) + q**2))
    return problem


def composed(problem: go.Problem) -> np.ndarray:
    """The guess of T and q (3, n_times), from their parts."""
    u, layout = guessed(problem).controls, problem.phases["burn"].model.controls
    part = {name: u[layout.slice(name)] for name in layout.names}
    return np.vstack([part["T_magnitude"] * part["T_direction"], part["q_plus"] - part["q_minus"]])


def test_laws_of_vector_and_split_controls() -> None:
    """A law names what the user declared; it is clipped to its norm, or to its bounds."""
    problem = pushed()
    t = problem.phases["burn"].model.time
    flown = go.guess_from_simulation(problem, {"T": ca.vertcat(3.0, 4.0) * t, "q": lambda t: -2.0 * t})
    times = FRACTIONS[:, None]
    norm = np.minimum(5.0 * FRACTIONS, 2.0)
    wanted = np.vstack([0.6 * norm, 0.8 * norm, -np.minimum(2.0 * times[:, 0], 1.0)])
    np.testing.assert_allclose(
        composed(flown), wanted, atol=1e-2
    )  # times of the kinks fall between two samples
    # integral of min(5 t, 2): 0.4 until t = 0.4, and 1.2 more; of -min(2 t, 1): -3 / 4
    np.testing.assert_allclose(guessed(flown).states[:, -1], [0.96, 1.28, -0.75], atol=1e-6)
    with pytest.raises(go.GncOptError, match=r"law of 'T' .* 3 components: give 2"):
        go.guess_from_simulation(problem, {"T": [1.0, 2.0, 3.0]})


def test_vector_and_split_controls_from_data_and_solutions() -> None:
    data = {"time": [0.0, 1.0], "T[0]": [0.3, 0.0], "T[1]": [0.0, 0.4], "q": [-0.5, 0.5]}
    line = np.array([0.3 - 0.3 * FRACTIONS, 0.4 * FRACTIONS, FRACTIONS - 0.5])
    np.testing.assert_allclose(composed(go.guess_from_data(pushed(), data)), line, atol=1e-12)
    solution = go.solve(pushed(plain=True).with_final(v=[1.0, -2.0], w=-0.5), mesh="2x3", tol=None)
    found = composed(go.guess_from_solution(pushed(), solution))
    np.testing.assert_allclose(found, np.tile([[1.0], [-2.0], [-0.5]], 11), atol=1e-6)
    there = pushed().with_final(v=[0.5, 0.0], w=0.5)
    back = go.guess_from_solution(pushed(plain=True), go.solve(there, mesh="2x3", tol=None))
    assert guessed(back).controls.shape == (3, 11)


def test_open_initial_values_and_free_parameters() -> None:
    model = go.Model("decay")
    x, u, k = model.state("x"), model.control("u"), model.parameter("k", 0.0)
    model.ode({x: u - k * x})
    problem = go.Problem("decay")
    problem.parameter("k", lower=0.0, upper=4.0, guess=2.0)
    leg = problem.phase("leg", model)
    leg.time(1.0, 2.0)
    problem.minimize(leg.integral(u**2 + x**2))
    start = guessed(go.guess_from_simulation(problem, {"u": 0.0}, initial={"x": 3.0}), "leg")
    np.testing.assert_allclose(start.states[0], 3.0 * np.exp(-2.0 * FRACTIONS), atol=1e-5)


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda p: go.guess_from_simulation(p, {"w": 0.0}), "no control 'w'"),
        (lambda p: go.guess_from_simulation(p, {"u": [1.0, 2.0, 3.0]}), "law of 'u' .* 3 components: give 2"),
        (
            lambda p: go.guess_from_simulation(p, {"u": p.phases["burn"].model.symbol("u")}),
            "uses controls of phase 'burn'",
        ),
        (lambda p: go.guess_from_simulation(p, {"u": "up"}), "law of 'u' .* is not a number"),
        (lambda p: go.guess_from_simulation(p, 0.0), "law of guess_from_simulation"),
        (
            lambda p: go.guess_from_simulation(p, {}, initial={"r": 0.0}),
            "rate of state 'v.0.' is nan at t = 0 s",
        ),
        (
            lambda p: go.guess_from_simulation(p, {}, until=p.phases["burn"].model.time + 1.0),
            "without a zero before",
        ),
        (lambda p: go.guess_from_simulation(p, {}, duration=-1.0), "duration of guess_from_simulation"),
        (lambda p: go.guess_from_simulation(p, {}, n=1), "n of guess_from_simulation"),
        (lambda p: go.guess_from_simulation(None, {}), "argument of guess_from_simulation"),
        (lambda p: go.guess_from_data(p, {"t": [0, 1]}), "no column 'time'"),
        (lambda p: go.guess_from_data(p, {"time": [0, 1], "r[0]": [0, 1]}), "a column 'r.0.' but no 'r.1.'"),
        (lambda p: go.guess_from_data(p, {"time": [0, 1], "q": [0, 1]}), "no column of a state or control"),
        (
            lambda p: go.guess_from_data(p, {"time": [0, 1], "r[0]": [0], "r[1]": [0]}),
            "differ in length, 1 and 2",
        ),
        (lambda p: go.guess_from_data(p, {"time": [1, 0], "r[0]": [0, 1], "r[1]": [0, 1]}), "must be finite"),
        (lambda p: go.guess_from_data(p, [1.0]), "is a list: give a mapping"),
        (lambda p: go.guess_from_solution(p, p), "solution of guess_from_solution"),
    ],
)
def test_mistakes_get_a_sentence(make: Any, message: str) -> None:
    with pytest.raises(go.GncOptError, match=message):
        make(spiral())


def hop(drag: bool, phase: str = "leg") -> go.Problem:
    model = go.Model("hop")
    x, v, u = model.state("x"), model.state("v"), model.control("u")
    fuel = {model.state("m"): -u} if drag else {}
    model.ode({x: v, v: u - (0.1 * v if drag else 0.0), **fuel})
    problem = go.Problem("hop")
    leg = problem.phase(phase, model)
    leg.time(0.0, 2.0)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=1.0, v=0.0)
    if drag:
        leg.initial(m=1.0)
    problem.minimize(leg.integral(u**2))
    return problem


def test_the_solution_of_a_simpler_problem() -> None:
    simple = go.solve(hop(drag=False), mesh="5x4", tol=None)
    problem = hop(drag=True, phase="flight")  # another phase, one state more
    start = guessed(go.guess_from_solution(problem, simple), "flight")
    np.testing.assert_allclose(start.states[0], simple.state("x")(2.0 * FRACTIONS), atol=1e-12)
    np.testing.assert_allclose(start.states[2], 1.0)
    with pytest.raises(go.ProblemError, match="use guess_from_solution"):
        go.solve(hop(drag=True), guess=simple, check=False)
    with pytest.raises(go.ProblemError, match="no phase with states or controls of the same names"):
        go.guess_from_solution(spiral(), simple)


def aimed(**parameters: int) -> go.Problem:
    """A cart from rest whose parameters, of the sizes given, are drawn to 3, 4, ..."""
    model, _x, u = dynamics("cart", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("aimed", model, 0.0, 1.0)
    leg.initial(x=0.0)
    cost = leg.integral(u**2)
    for name, size in parameters.items():
        p = problem.parameter(name, size, guess=[-1.0] * size)
        cost += sum((p[i] - 3 - i) ** 2 for i in range(size))
    problem.minimize(cost)
    return problem


def test_parameters_of_the_same_name_and_size_are_guessed_as_they_were_found() -> None:
    found = go.solve(aimed(a=1, b=2, c=2), mesh="1x3", tol=None)
    start = go.guess_from_solution(aimed(d=1, b=1, c=2), found)
    guess = {name: list(values) for name, values in start.parameter_guess.items()}
    assert guess["c"] == pytest.approx([3.0, 4.0], abs=1e-6)
    assert (guess["d"], guess["b"]) == ([-1.0], [-1.0])
    warm = go.solve(aimed(d=1, c=2), mesh="1x3", guess=found, tol=None)
    assert warm.parameter("c") == pytest.approx([3.0, 4.0], abs=1e-6)
    assert warm.parameter("d") == pytest.approx(3.0, abs=1e-6)
    none = go.guess_from_solution(aimed(d=1), found)
    assert list(none.parameter_guess["d"]) == [-1.0]


def filtered(bandwidth: float) -> go.Problem:
    """A double integrator behind a first-order filter, by much faster than the motion."""
    model = go.Model("filtered")
    x, v, a = (model.state(name) for name in "xva")
    u = model.control("u")
    model.ode({x: v, v: a, a: bandwidth * (u - a)})
    problem, leg = one_phase("filtered", model, initial=0.0, final=4.0)
    leg.initial(x=1.0, v=0.0, a=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.final_state("x"))
    return problem


def test_a_stiff_flight_goes_on_implicitly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Behind the filter with its lag 1/b the motion is x = 1 + c (t^2 / 2 - t / b + ...) with the command c."""
    monkeypatch.setattr(guess_simulation, "EXPLICIT_MAX_RATES", 3000)
    start = guessed(go.guess_from_simulation(filtered(1e6), {"u": 0.5}), "leg")
    assert start.states[0, -1] == pytest.approx(1 + 0.5 * (4**2 / 2 - 4e-6), abs=1e-4)
    assert start.states[1, -1] == pytest.approx(2.0, abs=1e-4)


def test_a_law_that_switches_without_end_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """On the line x + v = 0 it slides: sign() is 1 and -1 in turn at every step."""
    monkeypatch.setattr(guess_simulation, "EXPLICIT_MAX_RATES", 2000)
    monkeypatch.setattr(guess_simulation, "IMPLICIT_MAX_RATES", 4000)
    problem = filtered(1e5)
    x, v = (problem.phases["leg"].model.symbol(name) for name in "xv")
    with pytest.raises(go.ProblemError, match=r"4,000 evaluations .* reached only t = .* s\): .*tanh"):
        go.guess_from_simulation(problem, {"u": -ca.sign(x + v)})


def past_a_disc(centre: float = 0.0) -> go.Problem:
    """From (-5, 0) to (5, 0) m at rest in 10 s, at least 1 m from a point, told by a distance."""
    model, r, _v, a = dynamics("mover", "r:2 v:2", "a:2", lambda r, v, a: {r: v, v: a})
    problem, leg = one_phase("past a disc", model, initial=0.0, final=10.0, name="move")
    leg.initial(r=[-5.0, 0.0], v=[0.0, 0.0])
    leg.final(r=[5.0, 0.0], v=[0.0, 0.0])
    leg.path("distance", ca.norm_2(r - ca.DM([0.0, centre])), lower=1.0)
    problem.minimize(leg.integral(ca.sumsqr(a)))
    return problem


def test_a_line_through_the_centre_of_a_keep_out_is_bent() -> None:
    """Alone the way along x costs 12 d^2 / T^3 = 1.2; aside by 1 m at half time 2 * 12 / (T / 2)^3 = 0.192 more."""
    solution = go.solve(past_a_disc())
    assert solution.converged and go.verify(solution).ok
    assert solution.objective == pytest.approx(1.2 + 0.192, rel=1e-9)
    assert abs(solution.state("r")(5.0)[1]) == pytest.approx(1.0, abs=1e-8)


def test_only_lines_that_nobody_gave_are_bent() -> None:
    """A line that misses the centre stays; so do the user's states: a guess of theirs through the centre is refused."""
    clear = past_a_disc(0.1)
    assert with_curved_guess(clear) is clear
    r = with_curved_guess(past_a_disc()).phases["move"].numbers.guess.values["r"]
    np.testing.assert_allclose(r(np.array([0.0, 10.0])), [[-5.0, 5.0], [0.0, 0.0]], atol=1e-12)
    assert np.min(np.linalg.norm(r(np.linspace(0.0, 10.0, 201)), axis=0)) > 0.01
    problem = past_a_disc()
    problem.phases["move"].guess(r=([-5.0, 0.0], [5.0, 0.0]))
    with pytest.raises(
        go.ProblemError, match=r"derivative of path constraint 'distance' .* nan at the guess"
    ):
        problem.check()


def test_a_flown_guess_follows_the_dynamics_through_all_phases() -> None:
    """Phase after phase from where the last one ends, a mass dropped in between, with the controls as guessed."""
    problem = go.Problem("two stages")
    legs = []
    for name in ("first", "second"):
        model = go.Model(name)
        v, m, thrust = model.state("v"), model.state("m"), model.control("thrust")
        model.ode({v: thrust / m, m: -thrust / 3000.0})
        legs.append(problem.phase(name, model))
        legs[-1].bounds(thrust=(0.0, 1200.0))
    problem.sequence(*legs, durations={"first": 100.0, "second": (50.0, 150.0)}, drops={"first": {"m": 30.0}})
    legs[0].initial(v=0.0, m=200.0)
    legs[1].final(v=4000.0)
    problem.minimize(legs[1].final_time)
    flown = with_simulated_guess(problem)
    assert flown is not None
    first, second = (build_phase_guess(leg, np.linspace(0.0, 1.0, 5)) for leg in flown.phases.values())
    left = 200.0 - 20.0 * np.linspace(0.0, 1.0, 5)  # at 600 N, 0.2 kg/s
    np.testing.assert_allclose(first.states, [3000.0 * np.log(200.0 / left), left], rtol=2e-3)
    after, gained = left - 50.0, 3000.0 * np.log(200.0 / 180.0)
    np.testing.assert_allclose(second.states, [gained + 3000.0 * np.log(150.0 / after), after], rtol=2e-3)
    as_guessed = build_phase_guess(problem.phases["first"], np.linspace(0.0, 1.0, 5)).controls
    np.testing.assert_array_equal(first.controls, as_guessed)


@pytest.mark.slow
def test_ends_that_boundary_constraints_imply() -> None:
    """A stage of 9 t of fuel, 1 t of structure and a free payload p, by Tsiolkovsky: p = 9 t / (exp(dv / c) - 1) - 1 t.

    No bound, end or guess tells of the mass: zero, the guess without the constraints, is divided by.
    """
    model = go.Model("stage")
    v, m, idle = model.state("v"), model.state("m"), model.state("idle", 2)
    model.ode({v: 30e3 / m, m: -10.0, idle: [0.0, 0.0]})
    problem = go.Problem("payload")
    payload = problem.parameter("payload", lower=100.0, upper=20e3, guess=2e3)
    burn = problem.phase("burn", model)
    burn.time(0.0, (10.0, 5000.0))
    burn.initial(v=0.0)
    burn.final(v=3e3)
    problem.constrain("lift-off", 2 * burn.initial_state("m") - 2 * payload, equals=20e3)
    problem.constrain("dry", payload + 1e3 - burn.final_state("m"), upper=0.0)
    start, last = burn.initial_state("idle"), burn.final_state("idle")
    problem.constrain(
        "start", ca.vertcat(start[1], start[0] ** 2), equals=[7.0, 4.0]
    )  # a square tells no value
    problem.constrain("two unknowns", last - start, equals=[0.0, 0.0])
    problem.maximize(payload)

    states = guessed(problem).states
    assert states[1] == pytest.approx(np.linspace(12e3, 3e3, 11))
    assert states[2:, 0].tolist() == [0.0, 7.0]
    twin = problem.with_initial(m=5e3)
    assert guessed(twin).states[1, 0] == 5e3  # what is stated there comes first
    solution = go.solve(problem, mesh="5x4", tol=None)
    assert solution.objective == pytest.approx(9e3 / np.expm1(1.0) - 1e3, rel=1e-7)


@pytest.mark.filterwarnings("error")
def test_what_boundary_constraints_do_not_imply() -> None:
    """The middle of a range; nothing of times, of more than a line, of a slope of zero, or by way of infinity."""
    model = go.Model("still")
    x = model.state("x", 5)
    model.ode({x: np.zeros(5)})
    problem = go.Problem("still")
    leg, none = problem.phase("leg", model), problem.parameter("none", lower=-1.0, upper=1.0, guess=0.0)
    leg.time(0.0, (1.0, 9.0))
    start = leg.initial_state("x")
    problem.constrain("time", leg.final_time, upper=5.0)
    rows = ca.vertcat(start[0], (start[1] + 1) ** 2, none * start[2], start[3] - 1 / none, start[4] + none)
    problem.constrain("start", rows, lower=[2.0, 4.0, 4.0, 4.0, 4.0], upper=[4.0, 5.0, 5.0, 5.0, 5.0])
    assert leg.known_ends[("initial", "x")] == pytest.approx([3.0, np.nan, np.nan, np.nan, 4.5], nan_ok=True)


def cart() -> go.Problem:
    model, *_ = dynamics("cart", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("cart", model, initial=0.0, final=(0.5, 10.0))
    leg.initial(q=0.0, v=0.0)
    leg.bounds(a=(-3.0, 3.0))
    problem.minimize(leg.final_time)
    return problem


def test_tables_keep_their_times_when_others_join_with_their_own() -> None:
    problem = cart()
    leg = problem.phases["leg"]
    leg.guess([0.0, 1.0, 2.0], a=[0.0, 3.0, 1.0], v=0.5)
    leg.guess([0.0, 1.5], q=[0.0, 6.0])
    guess = leg.numbers.guess
    assert guess.time is not None
    np.testing.assert_array_equal(guess.time, [0.0, 1.0, 1.5])  # the end of what was given last
    np.testing.assert_array_equal(guess.values["a"], [[0.0, 3.0, 2.0]])
    np.testing.assert_array_equal(guess.values["q"], [[0.0, 4.0, 6.0]])
    assert guess.values["v"] == 0.5
    leg.guess([1.0, 2.0, 4.0])  # alone, times move what is there
    np.testing.assert_array_equal(leg.numbers.guess.values["a"], [[0.0, 3.0, 2.0]])
    leg.guess([0.0, 9.0], a=[1.0, 2.0], q=(0.0, 1.0))
    assert leg.numbers.guess.values["a"] == [1.0, 2.0]


def test_flown_guesses_stand_beside_tables_of_controls() -> None:
    problem = cart()
    problem.phases["leg"].guess([0.0, 1.0], a=[0.5, 0.5])
    flown = with_simulated_guess(problem)
    assert flown is not None
    found = build_phase_guess(flown.phases["leg"], np.linspace(0.0, 1.0, 11))
    np.testing.assert_allclose(found.controls, 0.5)
    assert found.states[0, -1] == pytest.approx(0.25 * found.times[1] ** 2, rel=1e-6)
