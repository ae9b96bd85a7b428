"""Costates from multipliers of the program, warm starts, and arcs on state limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from testing.constructed_solutions import cart, functions, phase, solution
from testing.internals import (
    SCHEMES,
    FixedArcs,
    PhaseCollocation,
    ScaledNlp,
    Scheme,
    build_nlp_point_from_guess,
    transcribe_problem,
)
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.array_types import Array
from gnc_opt.planning import ArcKind, Mesh, SolverOptions, guess_from_solution
from gnc_opt.planning.solution.costates import (
    NlpIterate,
    PhaseCostates,
    _compute_boundary_costates,
    compute_costates_at_collocation_points,
    correct_constraint_arc_costates,
    invert_costate_map,
    split_duplicate_multipliers,
)
from gnc_opt.planning.solution.initial_nlp_point import build_nlp_point_from_solution

# Multipliers become costates and come back: each scheme's rows by hand, and the ambiguities of held
# segments.


UNEVEN = Mesh((0.0, 0.3, 1.0), (3, 4))


def collocation(scheme: Scheme, mesh: Mesh = UNEVEN, n: int = 2, paths: int = 0) -> PhaseCollocation:
    return PhaseCollocation(scheme, mesh, n, 1, paths, 0, 0)


def rows_of(part: PhaseCollocation, pieces: list[Array]) -> Array:
    lam_g = np.zeros(part.n_rows)
    for rows, values in zip(part.dynamics_rows, pieces, strict=True):
        lam_g[rows] = values
    return lam_g


@pytest.mark.parametrize("scheme", SCHEMES)
def test_costates_of_multipliers_of_costates(scheme: Scheme) -> None:
    """LGL has a row less than points: its multipliers carry all but one combination of the point values."""
    part = collocation(scheme)
    values = np.random.default_rng(1).normal(size=(2, 7))
    ends = np.array([[1.0, 2.0], [3.0, 4.0]])
    pieces = invert_costate_map(part, values, ends)
    again = compute_costates_at_collocation_points(part, rows_of(part, pieces))
    if scheme != "LGL":
        assert again == pytest.approx(values, abs=1e-12)
        if scheme == "LG":
            assert [p[:, -1].tolist() for p in pieces] == [[-1.0, -3.0], [-2.0, -4.0]]
        return
    rows = rows_of(part, invert_costate_map(part, again, ends))
    once_more = compute_costates_at_collocation_points(part, rows)
    assert once_more == pytest.approx(again, abs=1e-11)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_boundary_costates_are_derivatives_of_each_segments_rows(scheme: Scheme) -> None:
    """From the rows as the program has them, with the other segment's multipliers zero."""
    part = collocation(scheme)
    lam_g = np.random.default_rng(2).normal(size=part.n_rows)
    gradients = np.random.default_rng(3).normal(size=(2, 7))
    starts, ends = _compute_boundary_costates(part, lam_g, gradients)
    rows, columns, values = part.linear_dynamics_nonzeros
    for k in range(2):
        own = np.zeros(part.n_rows)
        own[part.dynamics_rows[k]] = lam_g[part.dynamics_rows[k]]
        slope = np.zeros(part.n_variables)
        np.add.at(slope, columns, own[rows] * values)
        first, last = part.mesh.point_offsets[k], part.mesh.point_offsets[k + 1] - 1
        at_start = gradients[:, first] if scheme in ("LGR", "LGL") else 0.0
        at_end = gradients[:, last] if scheme == "LGL" else 0.0
        assert starts[:, k] == pytest.approx(slope[part.boundary_states[:, k]] + at_start)
        assert ends[:, k] == pytest.approx(-slope[part.boundary_states[:, k + 1]] - at_end)


TWO = Mesh((0.0, 0.5, 1.0), (3, 3))


def pieces(scheme: Scheme, mesh: Mesh = TWO, **changes: Any) -> PhaseCostates:
    """One state over 2 s, with costates that say where they are from."""
    part = collocation(scheme, mesh, n=1)
    size, segments = mesh.size, mesh.segments
    values = {
        "collocation": part,
        "weights": 2 * part.quadrature_weights,
        "lam": np.arange(1.0, size + 1)[None, :],
        "start": 10.0 + 10 * np.arange(segments)[None, :],
        "end": 30.0 + 10 * np.arange(segments)[None, :],
        "densities": np.zeros((1, size)),
        "impulses": np.zeros((1, segments + 1)),
        "decay": np.zeros((1, size)),
        "active": np.ones((1, segments), dtype=bool),
        "steady": np.zeros((1, segments), dtype=bool),
        "nonzero": np.ones((1, size), dtype=bool),
        "bounded": np.ones((1, size), dtype=bool),
    }
    return PhaseCostates(**(values | changes))


def test_between_the_points_costates_follow_their_differential_equation() -> None:
    """From the start with -pull for a rate where nothing holds; through the points where something does."""
    breaks = np.array([1.0, 2.0, 4.0])
    for scheme in ("LGR", "LGL"):
        found = pieces(scheme, decay=np.array([[2.0] * 3 + [3.0] * 3]), active=np.array([[False, False]]))
        curve = found.build_costate_polynomial(breaks)
        t = np.array([1.0, 1.3, 1.9])
        assert curve(t)[0] == pytest.approx(10 - 2 * (t - 1))
        t = np.array([2.0, 3.0, 3.9])
        assert curve(t)[0] == pytest.approx(20 - 3 * (t - 2))
        through = pieces(scheme).build_costate_polynomial(breaks)
        points = 1.5 + 0.5 * found.collocation.collocation_rules[0].points
        assert through(points, "left")[0] == pytest.approx([1, 2, 3])
    assert pieces("LGR").build_costate_polynomial(breaks)(2.0, "left")[0] == pytest.approx(30.0)
    gauss = pieces("LG").build_costate_polynomial(breaks)
    points = 3.0 + pieces("LG").collocation.collocation_rules[1].points
    assert gauss(points)[0] == pytest.approx([4, 5, 6]) and gauss(4.0)[0] == pytest.approx(40.0)


def doubled(left: list[float], right: list[float], *, mixed: bool = False, scheme: Scheme = "LGL") -> Array:
    part = collocation(scheme, Mesh((0.0, 0.5, 1.0), (3, 3)), n=1, paths=1)
    return split_duplicate_multipliers(
        part, np.array([[*left, *right]]), 2 * part.quadrature_weights, np.array([mixed])
    )


def test_a_path_constraint_that_is_stated_twice_belongs_to_the_side_where_it_is_active() -> None:
    """Densities 3 and 5 with equal weights: all 8 to the active side, or 4 to each of two."""
    assert doubled([0, 0, 3], [5, 2, 0]).tolist() == [[0, 0, 0, 8, 2, 0]]
    assert doubled([0, 2, 3], [5, 0, 0]).tolist() == [[0, 2, 8, 0, 0, 0]]
    assert doubled([0, 2, 3], [5, 2, 0]).tolist() == [[0, 2, 4, 4, 2, 0]]
    assert doubled([0, 0, 3], [5, 0, 0]).tolist() == [[0, 0, 3, 5, 0, 0]]
    assert doubled([0, 2, 3], [5, 0, 0], mixed=True).tolist() == [[0, 2, 3, 5, 0, 0]]
    assert doubled([0, 2, 3], [5, 0, 0], scheme="LGR").tolist() == [[0, 2, 3, 5, 0, 0]]


@pytest.mark.parametrize(("unit", "second"), [(1e-6, 1.0), (1e6, 1.0), (1.0, 1e-3), (1.0, 1e3)])
def test_what_pushes_does_not_depend_on_the_units_of_cost_and_time(unit: float, second: float) -> None:
    """Beside costates of all sizes, in a program of arbitrary numbers."""
    model, _x, _a = dynamics("one", "x:2", "a", lambda x, a: {x: a * np.ones(2)})
    problem, leg = one_phase("one", model, 0.0, 2.0)
    problem.minimize(leg.final_state("x")[0])
    transcription = transcribe_problem(problem, {"leg": Mesh((0.0, 0.5, 1.0), (4, 4))}, "LGL")
    part, random = transcription.parts["leg"].collocation, np.random.default_rng(4)
    lam_x = 10.0 ** random.uniform(-9, 0, transcription.n_variables)
    lam_g, x0 = random.normal(size=transcription.n_constraints), np.zeros(transcription.n_variables)
    gradient, push = random.normal(size=(2, 8)), 10.0 ** random.uniform(-9, 0, (2, 8))

    def found(c: float, t: float) -> PhaseCostates:
        weights = 2 * t * part.quadrature_weights
        return PhaseCostates.from_multipliers(
            part, NlpIterate(x0, c * lam_x, c * lam_g), weights, c / t * gradient, c / t * push
        )

    usual, other = found(1.0, 1.0), found(unit, second)
    assert np.sum(usual.nonzero) > 0 and 0 < np.sum(usual.bounded) < usual.bounded.size
    np.testing.assert_array_equal(other.nonzero, usual.nonzero)
    np.testing.assert_array_equal(other.bounded, usual.bounded)
    np.testing.assert_array_equal(other.active, usual.active)


def two_phases() -> go.Problem:
    """A cart over two phases with everything that has a multiplier: times, parameters, constraints, integrals."""
    problem = go.Problem("two phases")
    tight = problem.parameter("tight", lower=0.25)
    for i, name in enumerate(("first", "second")):
        model = go.Model(f"cart {i}")
        q, v, a = model.state("q"), model.state("v"), model.control("a")
        drag = model.parameter("drag", 0.1)
        model.ode({q: v, v: a - drag * v})
        leg = problem.phase(name, model)
        leg.bounds(a=(-3.0, 3.0), v=(-2.0, 2.0))
        leg.path("mixed", q + a, upper=3.5)
        leg.integral(a**2 + v**2, name="effort")
    first, second = problem.phases.values()
    first.time(0.0, (0.2, 3.0))
    second.time((0.2, 3.0), (0.5, 4.0), duration=(1.2, 5.0))
    first.initial(q=1.0, v=0.0)
    second.final(q=0.0, v=0.0)
    for name in ("q", "v"):
        problem.constrain(f"joined {name}", first.final_state(name) - second.initial_state(name), equals=0.0)
    problem.constrain("clock", first.final_time - second.initial_time, equals=0.0)
    problem.minimize(
        first.integral(first.model.symbol("a") ** 2, name="a1") * (1 + 0.01 * second.final_time)
        + second.integral(second.model.symbol("a") ** 2, name="a2")
        + second.final_time
        + (tight - 0.1) ** 2
    )
    return problem


@pytest.fixture(scope="module", params=SCHEMES)
def solved(request: pytest.FixtureRequest) -> tuple[ScaledNlp, Any, go.Solution]:
    problem = two_phases()
    meshes = {"first": Mesh((0.0, 0.4, 1.0), (4, 5)), "second": Mesh((0.0, 0.3, 1.0), (4, 4), (1,))}
    attempt = ScaledNlp.from_problem(problem, meshes, request.param, None, SolverOptions())
    point = attempt.build_scaled_nlp_point(attempt.start)
    attempt.solver.create_nlp_solver(point)
    result = attempt.solver.solve(point)
    assert result.status.solved, result.raw_status
    return attempt, result, attempt.build_solution_from_nlp_result(result)


def test_a_start_from_a_solution_on_its_own_mesh_is_its_iterate(solved: Any) -> None:
    """Variables and all multipliers, of every kind; LGL's dynamics multipliers as far as they are determined."""
    attempt, result, solution = solved
    scaling = attempt.scaling
    meshes = {name: leg.mesh for name, leg in solution.phases.items()}  # one boundary has moved
    transcription = ScaledNlp.from_problem(
        attempt.problem, meshes, solution.scheme, None, SolverOptions()
    ).transcription
    start = build_nlp_point_from_solution(transcription, attempt.problem, solution)
    places = transcription.integral_places
    start.x[places] = (result.x * scaling.variables)[places]
    assert start.x == pytest.approx(result.x * scaling.variables, abs=1e-7)
    lam_x = result.lam_x / scaling.variables / scaling.objective
    lam_g = result.lam_g * scaling.rows / scaling.objective
    assert np.max(np.abs(lam_x)) > 1e-2 and np.max(np.abs(lam_g)) > 1e-2
    assert start.lam_x == pytest.approx(lam_x, abs=1e-6)
    labels = transcription.constraint_row_labels
    arcs = [i for i, label in enumerate(labels) if label.startswith("length of arc")]
    assert start.lam_g[arcs] == pytest.approx(0.0)  # lengths of arcs are no limits of the problem
    assert np.delete(start.lam_g, arcs) == pytest.approx(np.delete(lam_g, arcs), abs=1e-6)


def test_a_start_on_another_mesh_is_sampled(solved: Any) -> None:
    """Signals at the new points from within their segments; impulses where a phase begins and ends, none between."""
    attempt, _, solution = solved
    meshes = {"first": Mesh((0.0, 0.3, 0.7, 1.0), (5, 3, 4)), "second": Mesh((0.0, 0.5, 1.0), (6, 6), (1,))}
    other = ScaledNlp.from_problem(
        attempt.problem, meshes, solution.scheme, None, SolverOptions()
    ).transcription
    start = build_nlp_point_from_solution(other, attempt.problem, solution)
    for name, part in other.parts.items():
        leg, there = solution.phases[name], part.collocation
        t = leg.initial_time + there.normalised_point_times * leg.duration
        ends = (
            there.normalised_point_times == 1.0
        )  # only there a point ends a segment where the old solution has a break

        def at(signal: Any, t: Array = t, ends: Any = ends) -> Array:
            return np.where(ends, signal(t, "left"), signal(t))

        weights = there.quadrature_weights * leg.duration * np.diff(arc_ends(part))[there.point_arc_indices]
        assert start.x[there.point_states] == pytest.approx(leg.x(t), abs=1e-12)
        assert start.x[there.point_controls] == pytest.approx(at(leg.applied.evaluate_clipped_polynomial))
        assert start.x[part.times[-1]] == pytest.approx(leg.final_time)
        assert start.lam_x[there.point_controls] == pytest.approx(at(leg.control_multiplier) * weights)
        assert start.lam_g[there.path_rows] == pytest.approx(at(leg.path_multiplier) * weights)
        if solution.scheme == "LG":
            assert compute_costates_at_collocation_points(there, start.lam_g) == pytest.approx(leg.lam(t))
            impulses = start.lam_x[there.boundary_states]
            assert impulses[:, [0, -1]] == pytest.approx(leg.state_impulses[:, [0, -1]])
            assert not impulses[:, 1:-1].any()
            assert start.lam_x[there.point_states] == pytest.approx(leg.state_multiplier(t) * weights)
    (middle,) = other.parts["second"].times[1:-1]
    second = solution.phases["second"]
    assert start.x[middle] == pytest.approx(0.5 * (second.initial_time + second.final_time))


def test_jumps_of_costates_and_impulses_come_back_on_their_mesh() -> None:
    """Costates that fall at 2 s, and impulses of both states at all three boundaries."""
    problem = guessed()
    impulses = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    leg = phase(
        problem,
        lambda t, k: [t, 2 * t],
        lambda t, k: 0.5 * t,
        lambda t, k: [t - 10 * k, 2 - k + 0 * t],
        breaks=(1.0, 2.0, 5.0),
        degree=3,
        state_impulses=impulses,
    )
    transcription = transcribe_problem(problem, {"leg": leg.mesh}, "LG")
    start = build_nlp_point_from_solution(transcription, problem, solution(problem, leg))
    part = transcription.parts["leg"].collocation
    assert start.lam_x[part.boundary_states] == pytest.approx(impulses)
    for k, end in enumerate(([2.0, 2.0], [-5.0, 1.0])):
        assert start.lam_g[part.dynamics_rows[k]][:, -1] == pytest.approx(-np.array(end))
    assert compute_costates_at_collocation_points(part, start.lam_g) == pytest.approx(leg.point_costates)
    assert _compute_boundary_costates(part, start.lam_g, np.zeros((2, 6)))[1] == pytest.approx(leg.lam_end)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("seed", [1, 2])
def test_states_do_not_know_of_each_other(scheme: Scheme, seed: int) -> None:
    """Of a thousand, one and a thousandth in size: held still, moved and pushed here and there, free; as one by one."""
    mesh, random, count = Mesh((0.0, 0.2, 0.5, 1.0), (3, 2, 4)), np.random.default_rng(seed), 3
    whole = collocation(scheme, mesh, count)
    states = whole.point_states
    sizes = np.array([1e3, 1.0, 1e-3])[:, None]
    x, lam_x, lam_g = (random.normal(size=whole.n_variables) for _ in range(3))
    lam_g = random.normal(size=whole.n_rows)
    push = random.normal(size=states.shape) * (random.random(states.shape) < 0.1) / sizes
    gradient = random.normal(size=states.shape) / sizes
    for i in range(count):
        for k in range(mesh.segments):
            lam_g[whole.dynamics_rows[k][i]] /= sizes[i]
        everywhere = np.unique(
            np.concatenate([whole.index_segment_states(k)[i] for k in range(mesh.segments)])
        )
        x[everywhere] *= sizes[i]
        lam_x[everywhere] *= (random.random(everywhere.size) < 0.2) / sizes[i]
    x[whole.index_segment_states(0)[0]] = 1e3
    weights, breaks = 5.0 * whole.quadrature_weights, 5.0 * np.asarray(mesh.breaks)

    def settled(part: PhaseCollocation, numbers: NlpIterate, gradient: Array, push: Array) -> PhaseCostates:
        return PhaseCostates.from_multipliers(part, numbers, weights, gradient, push)

    together = settled(whole, NlpIterate(x, lam_x, lam_g), gradient, push)
    assert together.steady[0, 0] and not together.steady[0].all() and not together.steady[1:].any()
    assert 0 < np.mean(together.active) < 1 and 0 < np.mean(together.bounded) < 1
    single = collocation(scheme, mesh, 1)
    for i in range(count):
        own = [np.zeros(single.n_variables), np.zeros(single.n_variables), np.zeros(single.n_rows)]
        for k in range(mesh.segments):
            for vector, given in zip(own, (x, lam_x), strict=False):
                vector[single.index_segment_states(k)[0]] = given[whole.index_segment_states(k)[i]]
            own[2][single.dynamics_rows[k][0]] = lam_g[whole.dynamics_rows[k][i]]
        for vector, given in zip(own, (x, lam_x), strict=False):
            vector[single.point_states[0]] = given[states[i]]
        alone = settled(single, NlpIterate(*own), gradient[[i]], push[[i]])
        for name in (
            "active",
            "steady",
            "nonzero",
            "bounded",
            "lam",
            "start",
            "end",
            "densities",
            "impulses",
            "decay",
        ):
            assert getattr(together, name)[i] == pytest.approx(getattr(alone, name)[0], rel=1e-9), name
        t = np.linspace(0.0, 5.0, 31)
        assert together.build_costate_polynomial(breaks)(t)[i] == pytest.approx(
            alone.build_costate_polynomial(breaks)(t)[0], rel=1e-9
        )
    paths = random.normal(size=(3, 9)) * (random.random((3, 9)) < 0.7) * sizes
    mixed = np.array([False, True, False])
    shared_out = split_duplicate_multipliers(whole, paths, weights, mixed)
    for i in range(3):
        one = split_duplicate_multipliers(whole, paths[[i]], weights, mixed[[i]])
        assert shared_out[i] == pytest.approx(one[0])


def arc_ends(part: Any) -> Array:
    """Shares of the phase at which its arcs begin and end."""
    return np.asarray(part.collocation.mesh.breaks)[list(part.collocation.mesh.arc_breaks)]


def test_a_solution_in_the_problems_own_terms(solved: Any) -> None:
    _, result, solution = solved
    assert solution.statistics.iterations == result.iterations and not solution.statistics.compiled_before
    assert solution.statistics.solve_s == result.wall_time
    assert solution.statistics.function_s == result.function_time
    assert solution.statistics.linear_solver_s == result.linear_solver_time
    assert solution.parameter("tight") == pytest.approx(0.25) and solution.parameter_multipliers[
        0
    ] == pytest.approx(-0.3)
    first, second = solution.phases["first"], solution.phases["second"]
    assert first.final_time == pytest.approx(second.initial_time) and first.initial_time == 0.0
    weight = 1 + 0.01 * second.final_time
    assert first.integral_weights == pytest.approx(
        [0.0, weight]
    ) and second.integral_weights == pytest.approx([0.0, 1.0])
    effort = [leg.integral(n) for leg, n in ((first, "a1"), (second, "a2"))]
    assert solution.objective == pytest.approx(weight * effort[0] + effort[1] + second.final_time + 0.0225)
    assert solution.provenance["mesh"].startswith("first 2x(4..5)")
    assert solution.provenance["scheme"] == solution.scheme
    assert solution.constraint_values == pytest.approx(np.zeros(3), abs=1e-8)
    assert solution.multiplier("joined v") == pytest.approx(first.costate("v")(first.final_time), abs=1e-5)
    assert first.costate("v")(first.final_time, "left") == pytest.approx(
        second.costate("v")(second.initial_time), abs=1e-5
    )
    assert first.x(first.final_time) == pytest.approx(second.x(second.initial_time), abs=1e-8)


def guessed(free: bool = True) -> go.Problem:
    problem = cart()
    leg = problem.get_phase()
    leg.time(1.0, (2.0, 9.0) if free else 5.0)
    leg.bounds(a=(-1.0, 1.0))
    leg.guess(time=(1.0, 5.0), q=(0.0, 8.0), a=(3.0, 0.5), v=lambda t: 2 * t)
    return problem


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_guess_fills_all_variables_and_stays_within_bounds(scheme: Scheme) -> None:
    problem = guessed()
    attempt = ScaledNlp.from_problem(
        problem, {"leg": Mesh((0.0, 0.25, 1.0), (3, 3))}, scheme, None, SolverOptions()
    )
    transcription = attempt.transcription
    x, part = build_nlp_point_from_guess(transcription, problem), transcription.parts["leg"]
    points = 1 + 4 * part.collocation.normalised_point_times
    assert x[part.collocation.boundary_states[:, 1]] == pytest.approx([2.0, 4.0])
    states = x[part.collocation.point_states]
    inner = ~np.isin(part.collocation.point_states[0], part.collocation.boundary_states[0])
    assert states[0, inner] == pytest.approx(2 * (points[inner] - 1)) and states[1, inner] == pytest.approx(
        2 * points[inner]
    )
    assert x[part.collocation.point_controls[0]] == pytest.approx(np.clip(3 - 2.5 * (points - 1) / 4, -1, 1))
    assert x[part.times[-1]] == 5.0 and part.times[0] >= transcription.n_variables
    assert x[part.collocation.boundary_states[:, 0]].tolist() == [0.0, 0.0]  # initial values are bounds


def test_the_trajectory_alone_becomes_the_guess(solved: Any) -> None:
    attempt, _, solution = solved
    problem = guess_from_solution(attempt.problem, solution)
    transcription = attempt.transcription
    x = build_nlp_point_from_guess(transcription, problem)
    start = build_nlp_point_from_solution(transcription, attempt.problem, solution)
    part = transcription.parts["second"]
    states = part.collocation.point_states
    assert x[part.times] == pytest.approx(start.x[part.times], abs=1e-9)
    assert x[states] == pytest.approx(start.x[states], abs=2e-2)
    for name, leg in solution.phases.items():
        value = problem.phases[name].numbers.guess.values["q"]
        middle = 0.5 * (leg.initial_time + leg.final_time)
        assert np.ravel(value(middle)) == pytest.approx(leg.state("q")(middle))
        assert np.ravel(value(leg.final_time + 1.0)) == pytest.approx(leg.state("q")(leg.final_time))
        control = problem.phases[name].numbers.guess.values["a"]
        assert np.ravel(control(leg.initial_time - 1.0)) == pytest.approx(
            leg.applied.evaluate_clipped_polynomial(leg.initial_time)[:1]
        )


def test_a_guess_of_another_problem_is_refused(solved: Any) -> None:
    _, _, solution = solved
    with pytest.raises(go.ProblemError, match="the guess has no phase 'leg', only"):
        ScaledNlp.from_problem(cart(), {"leg": Mesh.uniform(2, 3)}, "LG", solution, SolverOptions())


# Costates along arcs of state constraints: the points' polynomials are kept, what rows lay elsewhere is
# not.


LOW, FREE, UP, LEFT = ArcKind.LOWER, ArcKind.INTERIOR, ArcKind.UPPER, ArcKind.RELEASED


def plane() -> go.Problem:
    """q' = v, v' = a; paths on v + a, on q v, whose gradient turns along the flight, and on q."""
    model, q, v, a = dynamics("plane", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("plane", model, 0.0, 1.0)
    for label, value in (("mixed", v + a), ("product", q * v), ("height", q)):
        leg.path(label, value, upper=9.0)
    problem.minimize(leg.integral(a**2))
    return problem


PLANE = plane()
FUNCTIONS = functions(PLANE, (1.0,))


def states(t: Array, k: int) -> Any:
    return [1 + t + 10 * k, 2 - t + 0 * k]


def costates(t: Array, k: int) -> Any:
    return [t**2 + k, t**3 - k]


def leg(**changes: Any) -> go.PhaseSolution:
    """Three segments, their costates' ends off by 5 and 7."""
    arguments = PLANE, states, lambda t, k: 0 * t, costates
    values: dict[str, Any] = {
        "breaks": (0.0, 0.25, 0.5, 1.0),
        "paths": lambda t, k: [3 + 0 * t, 4 + 0 * t, 5 + 0 * t],
    }
    here = phase(*arguments, **values)
    off = np.array([[5.0], [7.0]])
    values |= {"lam_start": here.lam_start + off, "lam_end": here.lam_end - off}
    return phase(*arguments, **(values | changes))


def held(*rows: tuple[ArcKind, ...]) -> FixedArcs:
    return FixedArcs(((FREE,) * 3,), paths=rows)


def test_the_ends_continue_the_points_along_the_gradient_of_what_is_held() -> None:
    """q v is held along the second segment: its gradient is (v, q), from within the segment."""
    before = leg()
    after = correct_constraint_arc_costates(
        before, held((FREE,) * 3, (FREE, UP, FREE), (FREE,) * 3), FUNCTIONS
    )
    for ends, old, at, off in (
        ("lam_start", before.lam_start, 0.25, 1),
        ("lam_end", before.lam_end, 0.5, -1),
    ):
        q, v = states(np.array(at), 1)
        gradient, missing = np.array([v, q]), -off * np.array([5.0, 7.0])
        expected = old.copy()
        expected[:, 1] += gradient * (gradient @ missing) / (gradient @ gradient)
        assert getattr(after, ends) == pytest.approx(expected)
    last = after.lam.values[1][:, -1]
    assert last == pytest.approx(after.lam_end[:, 1]) and not np.allclose(last, before.lam.values[1][:, -1])
    for k in (0, 2):
        assert np.array_equal(after.lam.values[k], before.lam.values[k])
    assert np.array_equal(after.lam.values[1][:, :-1], before.lam.values[1][:, :-1])


def test_the_density_is_what_the_adjoint_equation_leaves() -> None:
    """lam_q' = -(mu_q + v mu_qv): with lam_q = t^2 and mu_qv = 4 then mu_q = -2 t - 4 (2 - t), where q is held."""
    before = leg(lam_end=leg().lam_end + np.array([[5.0], [7.0]]))  # ends that are right
    after = correct_constraint_arc_costates(before, held((UP,) * 3, (FREE,) * 3, (LOW, LEFT, UP)), FUNCTIONS)
    t = before.point_times
    expected = np.where((t > 0.25) & (t < 0.5), 5.0, -2 * t - 4 * (2 - t))
    assert after.path_multipliers[2] == pytest.approx(expected, abs=1e-9)
    assert np.array_equal(after.path_multipliers[:2], before.path_multipliers[:2])
