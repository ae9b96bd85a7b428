"""Multipliers become costates and come back: each scheme's rows by hand, and the ambiguities of held segments."""

from __future__ import annotations

import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from testing.constructed_solutions import cart, phase, solution
from testing.internals import (
    SCHEMES,
    Attempt,
    PhaseCollocation,
    Scheme,
    control_spans,
    start_from_guess,
    transcribe,
)

import gnc_opt as go
from gnc_opt.arrays import Array
from gnc_opt.planning import ArcKind, Mesh, SolverOptions, guess_from_solution
from gnc_opt.planning.solution.costates import (
    Iterate,
    _boundary_costates,
    _CostatePieces,
    _held_segments,
    _lengths,
    _still_segments,
    point_costates,
    point_multipliers,
    settle_doubled_paths,
)
from gnc_opt.planning.solution.extract import (
    _mesh_in_time,
    _point_times,
    _time_multipliers,
    extract_phases,
    model_parameters,
)
from gnc_opt.planning.solution.warm_start import _put_end_rows, start_from_solution, with_integrals

UNEVEN = Mesh((0.0, 0.3, 1.0), (3, 4))


def collocation(scheme: Scheme, mesh: Mesh = UNEVEN, n: int = 2, paths: int = 0) -> PhaseCollocation:
    return PhaseCollocation(scheme, mesh, n, 1, paths, 0, 0)


def rows_of(part: PhaseCollocation, pieces: list[Array]) -> Array:
    lam_g = np.zeros(part.n_rows)
    for rows, values in zip(part.dynamics_rows, pieces, strict=True):
        lam_g[rows] = values
    return lam_g


# --- the mapping ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", SCHEMES)
def test_costates_of_multipliers_of_costates(scheme: Scheme) -> None:
    """LGL has a row less than points: its multipliers carry all but one combination of the point values."""
    part = collocation(scheme)
    values = np.random.default_rng(1).normal(size=(2, 7))
    ends = np.array([[1.0, 2.0], [3.0, 4.0]])
    pieces = point_multipliers(part, values, ends)
    again = point_costates(part, rows_of(part, pieces))
    if scheme != "LGL":
        assert again == pytest.approx(values, abs=1e-12)
        if scheme == "LG":
            assert [p[:, -1].tolist() for p in pieces] == [[-1.0, -3.0], [-2.0, -4.0]]
        return
    once_more = point_costates(part, rows_of(part, point_multipliers(part, again, ends)))
    assert once_more == pytest.approx(again, abs=1e-11)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_boundary_costates_are_derivatives_of_each_segments_rows(scheme: Scheme) -> None:
    """From the rows as the program has them, with the other segment's multipliers zero."""
    part = collocation(scheme)
    lam_g = np.random.default_rng(2).normal(size=part.n_rows)
    gradients = np.random.default_rng(3).normal(size=(2, 7))
    starts, ends = _boundary_costates(part, lam_g, gradients)
    rows, columns, values = part.linear
    for k in range(2):
        own = np.zeros(part.n_rows)
        own[part.dynamics_rows[k]] = lam_g[part.dynamics_rows[k]]
        slope = np.zeros(part.n_variables)
        np.add.at(slope, columns, own[rows] * values)
        first, last = part.mesh.offsets[k], part.mesh.offsets[k + 1] - 1
        at_start = gradients[:, first] if scheme in ("LGR", "LGL") else 0.0
        at_end = gradients[:, last] if scheme == "LGL" else 0.0
        assert starts[:, k] == pytest.approx(slope[part.boundary_states[:, k]] + at_start)
        assert ends[:, k] == pytest.approx(-slope[part.boundary_states[:, k + 1]] - at_end)


# --- which segments are held ------------------------------------------------------------------------------


def test_segments_are_held_by_pushes_within_or_if_there_are_none_at_all_points() -> None:
    part = collocation("LGL", Mesh((0.0, 0.5, 1.0), (2, 3)), n=1)
    shared = np.array([[True, True, True, False, True]])
    for pushed, held in (
        ([0, 0, 0, 1, 0], [False, True]), ([1, 1, 1, 0, 1], [True, False]), ([1, 0, 0, 0, 0], [False, False]),
    ):  # fmt: skip
        assert _held_segments(part, np.array([pushed], dtype=bool), shared).tolist() == [held]


def test_a_state_is_still_relative_to_its_size() -> None:
    part = collocation("LG", Mesh((0.0, 0.5, 1.0), (2, 2)), n=2)
    x = np.zeros(part.n_variables)
    x[part.segment_nodes(0)[0]], x[part.segment_nodes(1)[0]] = 5.0, 5.0
    x[part.segment_nodes(1)[0, 1]] += 1e-6
    assert _still_segments(part, x).tolist() == [[True, False], [True, True]]
    x[part.segment_nodes(1)[0, 1]] = 5.0 + 1e-8
    assert _still_segments(part, -x).tolist() == [[True, True], [True, True]]


def test_lengths_of_segments() -> None:
    part = collocation("LGR")
    assert _lengths(part, 10 * part.quadrature) == pytest.approx([3.0, 7.0])


# --- ambiguities that are settled -------------------------------------------------------------------------

TWO = Mesh((0.0, 0.5, 1.0), (3, 3))


def pieces(scheme: Scheme, mesh: Mesh = TWO, **changes: Any) -> _CostatePieces:
    """One state over 2 s, with costates that say where they are from."""
    part = collocation(scheme, mesh, n=1)
    size, segments = mesh.size, mesh.segments
    values = {
        "collocation": part,
        "weights": 2 * part.quadrature,
        "lam": np.arange(1.0, size + 1)[None, :],
        "start": 10.0 + 10 * np.arange(segments)[None, :],
        "end": 30.0 + 10 * np.arange(segments)[None, :],
        "densities": np.zeros((1, size)),
        "impulses": np.zeros((1, segments + 1)),
        "pull": np.zeros((1, size)),
        "held": np.ones((1, segments), dtype=bool),
        "still": np.zeros((1, segments), dtype=bool),
        "pushed": np.ones((1, size), dtype=bool),
        "bounded": np.ones((1, size), dtype=bool),
    }
    return _CostatePieces(**(values | changes))


def test_held_segments_end_with_the_costates_of_their_points() -> None:
    """Lobatto weights 1/6 s at the boundary: what start and end lack there becomes a density, out of the impulse."""
    found = pieces("LGL")
    found.split_boundary_multipliers()
    assert (found.start.tolist(), found.end.tolist()) == ([[10, 4]], [[3, 40]])
    assert found.densities == pytest.approx(np.array([[0, 0, 6 * 27, -6 * 16, 0, 0]]))
    assert found.impulses.tolist() == [[0, -27 + 16, 0]]


def test_at_the_ends_of_a_phase_only_a_still_state_is_held() -> None:
    found = pieces("LGL", still=np.array([[True, True]]))
    found.split_boundary_multipliers()
    assert (found.start.tolist(), found.end.tolist()) == ([[1, 4]], [[3, 6]])
    assert found.densities[0, [0, 5]] == pytest.approx([-6 * 9, 6 * 34]) and found.impulses.tolist() == [
        [9, -11, -34]
    ]
    free = pieces("LGL", still=np.array([[True, True]]), bounded=np.zeros((1, 6), dtype=bool))
    free.split_boundary_multipliers()
    assert (free.start.tolist(), free.end.tolist()) == ([[10, 4]], [[3, 40]])
    assert not free.densities.any() and not free.impulses.any()


@pytest.mark.parametrize(
    "changes", [{"held": np.zeros((1, 2), dtype=bool)}, {"pushed": np.zeros((1, 6), dtype=bool)}]
)
def test_where_nothing_holds_nothing_is_split(changes: dict[str, Any]) -> None:
    found = pieces("LGL", **changes)
    found.split_boundary_multipliers()
    assert (found.start.tolist(), found.end.tolist()) == ([[10, 20]], [[30, 40]])
    assert not found.densities.any() and not found.impulses.any()


def test_radau_segments_are_split_at_their_start_alone() -> None:
    found = pieces("LGR")
    found.split_boundary_multipliers()
    assert (found.start.tolist(), found.end.tolist()) == ([[10, 4]], [[30, 40]])
    assert found.densities[0, 3] == pytest.approx((4 - 20) / found.weights[3])
    assert found.impulses.tolist() == [[0, 16, 0]]


def redundant(push: float, change: float, **changes: Any) -> tuple[_CostatePieces, Array]:
    """A still Gauss segment: costates 2 + tau, so 3 at its end; bound multipliers so much more than the oscillation."""
    part = collocation("LG", Mesh((0.0, 1.0), (3,)), n=1)
    e, weights = part.rules[0].end_values, 2 * part.quadrature
    values = {
        "lam": 2 + part.rules[0].points[None, :],
        "start": np.array([[5.0]]),
        "end": np.array([[3.0 - change]]),
        "densities": (push + change * e[1:] / weights)[None, :],
        "still": np.array([[True]]),
    } | changes
    return pieces("LG", Mesh((0.0, 1.0), (3,)), **values), e


def test_a_redundant_row_gives_its_multiplier_to_the_bounds() -> None:
    found, e = redundant(7.0, 2.0)
    found.settle_redundant_rows()
    assert found.end == pytest.approx(np.array([[3.0]])) and found.start == pytest.approx(
        np.array([[5 + 2 * e[0]]])
    )
    assert found.densities == pytest.approx(np.array([[7.0, 7.0, 7.0]]))
    assert found.impulses == pytest.approx(np.array([[-2 * e[0], 2.0]]))
    below, _ = redundant(-7.0, -2.0)
    below.settle_redundant_rows()
    assert below.densities == pytest.approx(np.array([[-7.0] * 3])) and below.end[0, 0] == pytest.approx(3.0)


@pytest.mark.parametrize(
    "changes",
    [
        {"still": np.array([[False]])},
        {"bounded": np.zeros((1, 3), dtype=bool)},
        {"densities": np.zeros((1, 3))},
    ],
    ids=["moving", "free", "turned"],
)
def test_a_row_that_is_not_redundant_keeps_its_multiplier(changes: dict[str, Any]) -> None:
    """The last one would need pushes of both signs."""
    found, _ = redundant(7.0, 2.0, **changes)
    before = found.densities.copy()
    found.settle_redundant_rows()
    assert found.end.tolist() == [[1.0]] and found.start.tolist() == [[5.0]] and not found.impulses.any()
    assert np.array_equal(found.densities, before)


@pytest.mark.parametrize(("contrary", "end"), [(-0.003, 3.0), (-0.005, 1.0)])
def test_a_trifle_of_a_push_to_the_other_side_speaks_not_against_it(contrary: float, end: float) -> None:
    """Beyond a thousandth of the change of 2 it does: the last weight is 5/9 s, hence 0.0036 per second."""
    found, _ = redundant(7.0, 2.0)
    found.densities[0, 2] += contrary - 7.0
    assert found.weights[2] == pytest.approx(5 / 9)
    found.settle_redundant_rows()
    assert found.end[0, 0] == pytest.approx(end)


def test_one_bounded_point_is_enough() -> None:
    found, _ = redundant(7.0, 2.0, bounded=np.array([[False, True, False]]))
    found.settle_redundant_rows()
    assert found.end[0, 0] == pytest.approx(3.0)


def test_between_the_points_costates_follow_their_differential_equation() -> None:
    """From the start with -pull for a rate where nothing holds; through the points where something does."""
    breaks = np.array([1.0, 2.0, 4.0])
    for scheme in ("LGR", "LGL"):
        found = pieces(scheme, pull=np.array([[2.0] * 3 + [3.0] * 3]), held=np.array([[False, False]]))
        curve = found.polynomial(breaks)
        t = np.array([1.0, 1.3, 1.9])
        assert curve(t)[0] == pytest.approx(10 - 2 * (t - 1))
        t = np.array([2.0, 3.0, 3.9])
        assert curve(t)[0] == pytest.approx(20 - 3 * (t - 2))
        through = pieces(scheme).polynomial(breaks)
        points = 1.5 + 0.5 * found.collocation.rules[0].points
        assert through(points, "left")[0] == pytest.approx([1, 2, 3])
    assert pieces("LGR").polynomial(breaks)(2.0, "left")[0] == pytest.approx(30.0)
    gauss = pieces("LG").polynomial(breaks)
    points = 3.0 + pieces("LG").collocation.rules[1].points
    assert gauss(points)[0] == pytest.approx([4, 5, 6]) and gauss(4.0)[0] == pytest.approx(40.0)


def doubled(left: list[float], right: list[float], *, mixed: bool = False, scheme: Scheme = "LGL") -> Array:
    part = collocation(scheme, Mesh((0.0, 0.5, 1.0), (3, 3)), n=1, paths=1)
    return settle_doubled_paths(part, np.array([[*left, *right]]), 2 * part.quadrature, np.array([mixed]))


def test_a_path_constraint_that_is_stated_twice_belongs_to_the_side_where_it_is_active() -> None:
    """Densities 3 and 5 with equal weights: all 8 to the active side, or 4 to each of two."""
    assert doubled([0, 0, 3], [5, 2, 0]).tolist() == [[0, 0, 0, 8, 2, 0]]
    assert doubled([0, 2, 3], [5, 0, 0]).tolist() == [[0, 2, 8, 0, 0, 0]]
    assert doubled([0, 2, 3], [5, 2, 0]).tolist() == [[0, 2, 4, 4, 2, 0]]
    assert doubled([0, 0, 3], [5, 0, 0]).tolist() == [[0, 0, 3, 5, 0, 0]]
    assert doubled([0, 2, 3], [5, 0, 0], mixed=True).tolist() == [[0, 2, 3, 5, 0, 0]]
    assert doubled([0, 2, 3], [5, 0, 0], scheme="LGR").tolist() == [[0, 2, 3, 5, 0, 0]]


def test_shares_go_by_the_weights_of_unlike_segments() -> None:
    """Segments of 1 s and 3 s: weights 1/6 s and 1/2 s, so that 3 and 5 there are a density of (1/2 + 5/2) / (2/3)."""
    part = collocation("LGL", Mesh((0.0, 0.25, 1.0), (3, 3)), n=1, paths=1)
    found = settle_doubled_paths(
        part, np.array([[0.0, 2, 3, 5, 2, 0]]), 4 * part.quadrature, np.array([False])
    )
    assert found == pytest.approx(np.array([[0, 2, 4.5, 4.5, 2, 0]]))
    one_sided = settle_doubled_paths(
        part, np.array([[0.0, 2, 3, 5, 0, 0]]), 4 * part.quadrature, np.array([False])
    )
    assert one_sided == pytest.approx(np.array([[0, 2, 18.0, 0, 0, 0]]))


def test_a_path_is_mixed_if_any_control_moves_it_anywhere() -> None:
    """One of two controls, with a factor that vanishes at the start: its doubled multipliers stay what they are."""
    model = go.Model("two")
    x, y = model.state("x"), model.state("y")
    a, b = model.control("a"), model.control("b")
    model.ode({x: a, y: b})
    problem = go.Problem("two")
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
    leg.path("mixed", y + a * model.time, upper=9.0)
    leg.path("pure", x, upper=9.0)
    problem.minimize(leg.final_state("x"))
    transcription = transcribe(problem, {"leg": Mesh((0.0, 0.5, 1.0), (4, 4))}, "LGL")
    collocation = transcription.parts["leg"].collocation
    lam = np.zeros(transcription.n_constraints)
    lam[collocation.path_rows] = [np.arange(1.0, 9.0), np.arange(1.0, 9.0)]
    iterate = Iterate(np.zeros(transcription.n_variables), np.zeros(transcription.n_variables), lam)
    phases, _ = extract_phases(transcription, problem, iterate)
    densities = np.arange(1.0, 9.0) / (2 * collocation.quadrature)
    np.testing.assert_allclose(phases["leg"].path_multipliers[0], densities)
    assert np.max(np.abs(phases["leg"].path_multipliers[1] - densities)[3:5]) > 0.1


@pytest.mark.parametrize(("unit", "second"), [(1e-6, 1.0), (1e6, 1.0), (1.0, 1e-3), (1.0, 1e3)])
def test_what_pushes_does_not_depend_on_the_units_of_cost_and_time(unit: float, second: float) -> None:
    """Beside costates of all sizes, in a program of arbitrary numbers."""
    model = go.Model("one")
    x, a = model.state("x", 2), model.control("a")
    model.ode({x: a * np.ones(2)})
    problem = go.Problem("one")
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
    problem.minimize(leg.final_state("x")[0])
    transcription = transcribe(problem, {"leg": Mesh((0.0, 0.5, 1.0), (4, 4))}, "LGL")
    part, random = transcription.parts["leg"].collocation, np.random.default_rng(4)
    lam_x = 10.0 ** random.uniform(-9, 0, transcription.n_variables)
    lam_g, x0 = random.normal(size=transcription.n_constraints), np.zeros(transcription.n_variables)
    gradient, push = random.normal(size=(2, 8)), 10.0 ** random.uniform(-9, 0, (2, 8))

    def found(c: float, t: float) -> _CostatePieces:
        weights = 2 * t * part.quadrature
        return _CostatePieces.of(
            part, Iterate(x0, c * lam_x, c * lam_g), weights, c / t * gradient, c / t * push
        )

    usual, other = found(1.0, 1.0), found(unit, second)
    assert np.sum(usual.pushed) > 0 and 0 < np.sum(usual.bounded) < usual.bounded.size
    np.testing.assert_array_equal(other.pushed, usual.pushed)
    np.testing.assert_array_equal(other.bounded, usual.bounded)
    np.testing.assert_array_equal(other.held, usual.held)


@pytest.mark.parametrize(("pull", "curvature", "worth"), [(3.0, 0.0, 6.0), (0.1, 5.0, 20.0)])
def test_an_idle_control_spans_what_is_worth_as_much_as_the_others(
    pull: float, curvature: float, worth: float
) -> None:
    """Of a, over 2, the slope or the curvature counts; b, with the curvature 4, moves as far as is worth that."""
    model = go.Model("two")
    x, y = model.state("x"), model.state("y")
    a, b = model.control("a"), model.control("b")
    model.ode({x: a, y: b})
    problem = go.Problem("two")
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
    problem.minimize(leg.final_state("x"))
    one = phase(problem, *(lambda t, k: np.array([t, 0 * t]),) * 3)
    flown, ones = np.array([np.linspace(0, 2, 5), np.zeros(5)]), np.ones(5)
    found = control_spans(
        one, flown, np.array([pull * ones, 0 * ones]), np.array([curvature * ones, 4 * ones]), 1e3
    )
    np.testing.assert_allclose(found, [2.0, np.sqrt(worth / 4)])


def test_end_rows_of_a_start_are_known_or_nothing() -> None:
    """Boundary constraints, durations and integrals by their labels; a row that the guess does not have gets 0."""
    leg = SimpleNamespace(
        duration_multiplier=0.5, integral_labels=("cost",), integral_weights=np.array([3.0])
    )
    guess: Any = SimpleNamespace(
        constraint_labels=("near", "far"), constraint_multipliers=np.array([7.0, 8.0]), phases={"leg": leg}
    )
    labels = (
        "constraint far", "duration of phase leg", "integral cost, phase leg", "constraint new", "constraint near",
    )  # fmt: skip
    transcription: Any = SimpleNamespace(end_rows=dict(zip(labels, (4, 1, 3, 0, 2), strict=True)))
    lam = np.full(6, 9.0)
    _put_end_rows(transcription, guess, lam)
    assert lam.tolist() == [0.0, 0.5, 7.0, -3.0, 8.0, 9.0]


# --- from the program and back ----------------------------------------------------------------------------


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
        + second.integral(second.model.symbol("a") ** 2, name="a2") + second.final_time + (tight - 0.1) ** 2
    )  # fmt: skip
    return problem


@pytest.fixture(scope="module", params=SCHEMES)
def solved(request: pytest.FixtureRequest) -> tuple[Attempt, Any, go.Solution]:
    problem = two_phases()
    meshes = {"first": Mesh((0.0, 0.4, 1.0), (4, 5)), "second": Mesh((0.0, 0.3, 1.0), (4, 4), (1,))}
    attempt = Attempt.prepare(problem, meshes, request.param, None, SolverOptions())
    point = attempt.point(attempt.start)
    attempt.solver.set_up(point)
    result = attempt.solver.solve(point)
    assert result.status.solved, result.raw_status
    return attempt, result, attempt.solution(result)


def test_a_start_from_a_solution_on_its_own_mesh_is_its_iterate(solved: Any) -> None:
    """Variables and all multipliers, of every kind; LGL's dynamics multipliers as far as they are determined."""
    attempt, result, solution = solved
    scaling = attempt.scaling
    meshes = {name: leg.mesh for name, leg in solution.phases.items()}  # one boundary has moved
    transcription = Attempt.prepare(
        attempt.problem, meshes, solution.scheme, None, SolverOptions()
    ).transcription
    start = start_from_solution(
        transcription, attempt.problem, solution, np.full(transcription.n_variables, np.nan)
    )
    places = transcription.integral_places
    start.x[places] = (result.x * scaling.variables)[places]
    assert start.x == pytest.approx(result.x * scaling.variables, abs=1e-7)
    lam_x = result.lam_x / scaling.variables / scaling.objective
    lam_g = result.lam_g * scaling.rows / scaling.objective
    assert start.lam_x is not None and start.lam_g is not None
    assert np.max(np.abs(lam_x)) > 1e-2 and np.max(np.abs(lam_g)) > 1e-2
    assert start.lam_x == pytest.approx(lam_x, abs=1e-6)
    arcs = [i for i, label in enumerate(transcription.row_labels) if label.startswith("length of arc")]
    assert start.lam_g[arcs] == pytest.approx(0.0)  # lengths of arcs are no limits of the problem
    assert np.delete(start.lam_g, arcs) == pytest.approx(np.delete(lam_g, arcs), abs=1e-6)


def test_a_start_on_another_mesh_is_sampled(solved: Any) -> None:
    """Signals at the new points from within their segments; impulses where a phase begins and ends, none between."""
    attempt, _, solution = solved
    meshes = {"first": Mesh((0.0, 0.3, 0.7, 1.0), (5, 3, 4)), "second": Mesh((0.0, 0.5, 1.0), (6, 6), (1,))}
    other = Attempt.prepare(attempt.problem, meshes, solution.scheme, None, SolverOptions()).transcription
    start = start_from_solution(other, attempt.problem, solution, np.zeros(other.n_variables))
    assert start.lam_x is not None and start.lam_g is not None
    for name, part in other.parts.items():
        leg, there = solution.phases[name], part.collocation
        t = leg.initial_time + there.fractions * leg.duration
        ends = there.fractions == 1.0  # only there a point ends a segment where the old solution has a break

        def at(signal: Any, t: Array = t, ends: Any = ends) -> Array:
            return np.where(ends, signal(t, "left"), signal(t))

        weights = there.quadrature * leg.duration * np.diff(arc_ends(part))[there.point_arcs]
        assert start.x[there.point_states] == pytest.approx(leg.x(t), abs=1e-12)
        assert start.x[there.point_controls] == pytest.approx(at(leg.flown.clipped))
        assert start.x[part.times[-1]] == pytest.approx(leg.final_time)
        assert start.lam_x[there.point_controls] == pytest.approx(at(leg.control_multiplier) * weights)
        assert start.lam_g[there.path_rows] == pytest.approx(at(leg.path_multiplier) * weights)
        if solution.scheme == "LG":
            assert point_costates(there, start.lam_g) == pytest.approx(leg.lam(t))
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
        problem, lambda t, k: [t, 2 * t], lambda t, k: 0.5 * t, lambda t, k: [t - 10 * k, 2 - k + 0 * t],
        breaks=(1.0, 2.0, 5.0), degree=3, state_impulses=impulses,
    )  # fmt: skip
    transcription = transcribe(problem, {"leg": leg.mesh}, "LG")
    start = start_from_solution(
        transcription, problem, solution(problem, leg), np.zeros(transcription.n_variables)
    )
    part = transcription.parts["leg"].collocation
    assert start.lam_x is not None and start.lam_g is not None
    assert start.lam_x[part.boundary_states] == pytest.approx(impulses)
    for k, end in enumerate(([2.0, 2.0], [-5.0, 1.0])):
        assert start.lam_g[part.dynamics_rows[k]][:, -1] == pytest.approx(-np.array(end))
    assert point_costates(part, start.lam_g) == pytest.approx(leg.point_costates)
    assert _boundary_costates(part, start.lam_g, np.zeros((2, 6)))[1] == pytest.approx(leg.lam_end)


def test_points_take_what_is_on_their_side_of_a_jump() -> None:
    """Controls and costates jump at 2 s; a warm start has them as they were.

    It has the costates of the points where mesh and scheme are the same, elsewhere those between the points.
    """
    problem = guessed()

    def flown(scheme: Scheme) -> Any:
        found = phase(
            problem, lambda t, k: [t, 2 * t], lambda t, k: 0.1 * t - 0.5 * k,
            lambda t, k: [t - 10 * k, 2 - k + 0 * t], breaks=(1.0, 2.0, 5.0), degree=3, scheme=scheme,
        )  # fmt: skip
        return replace(found, point_costates=found.point_costates + 0.25)

    def started(leg: Any, scheme: Scheme, mesh: Mesh) -> tuple[Any, Array, Array]:
        transcription = transcribe(problem, {"leg": mesh}, scheme)
        start = start_from_solution(
            transcription, problem, solution(problem, leg), np.zeros(transcription.n_variables)
        )
        part = transcription.parts["leg"].collocation
        assert start.lam_g is not None
        return part, start.x, point_costates(part, start.lam_g)

    for scheme in SCHEMES:
        leg = flown(scheme)
        part, x, lam = started(leg, scheme, leg.mesh)
        assert x[part.point_controls] == pytest.approx(np.hstack(leg.u.values))
        if scheme != "LGL":
            assert lam == pytest.approx(leg.point_costates)
    leg = flown("LGR")
    for scheme, mesh in (("LG", leg.mesh), ("LGR", Mesh(leg.mesh.breaks, (3, 4)))):
        part, _, lam = started(leg, scheme, mesh)  # type: ignore[arg-type]
        times = 1 + 4 * part.fractions
        assert lam == pytest.approx(np.where(times >= 2, [times - 10, 1 + 0 * times], [times, 2 + 0 * times]))


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
        everywhere = np.unique(np.concatenate([whole.segment_nodes(k)[i] for k in range(mesh.segments)]))
        x[everywhere] *= sizes[i]
        lam_x[everywhere] *= (random.random(everywhere.size) < 0.2) / sizes[i]
    x[whole.segment_nodes(0)[0]] = 1e3
    weights, breaks = 5.0 * whole.quadrature, 5.0 * np.asarray(mesh.breaks)

    def settled(part: PhaseCollocation, numbers: Iterate, gradient: Array, push: Array) -> _CostatePieces:
        found = _CostatePieces.of(part, numbers, weights, gradient, push)
        if scheme == "LG":
            found.settle_redundant_rows()
        else:
            found.split_boundary_multipliers()
        return found

    together = settled(whole, Iterate(x, lam_x, lam_g), gradient, push)
    assert together.still[0, 0] and not together.still[0].all() and not together.still[1:].any()
    assert 0 < together.held.sum() < together.held.size and 0 < together.bounded.sum() < together.bounded.size
    single = collocation(scheme, mesh, 1)
    for i in range(count):
        own = [np.zeros(single.n_variables), np.zeros(single.n_variables), np.zeros(single.n_rows)]
        for k in range(mesh.segments):
            for vector, given in zip(own, (x, lam_x), strict=False):
                vector[single.segment_nodes(k)[0]] = given[whole.segment_nodes(k)[i]]
            own[2][single.dynamics_rows[k][0]] = lam_g[whole.dynamics_rows[k][i]]
        for vector, given in zip(own, (x, lam_x), strict=False):
            vector[single.point_states[0]] = given[states[i]]
        alone = settled(single, Iterate(*own), gradient[[i]], push[[i]])
        for name in (
            "held",
            "still",
            "pushed",
            "bounded",
            "lam",
            "start",
            "end",
            "densities",
            "impulses",
            "pull",
        ):
            assert getattr(together, name)[i] == pytest.approx(getattr(alone, name)[0], rel=1e-9), name
        t = np.linspace(0.0, 5.0, 31)
        assert together.polynomial(breaks)(t)[i] == pytest.approx(alone.polynomial(breaks)(t)[0], rel=1e-9)
    paths, mixed = (
        random.normal(size=(3, 9)) * (random.random((3, 9)) < 0.7) * sizes,
        np.array([False, True, False]),
    )
    shared_out = settle_doubled_paths(whole, paths, weights, mixed)
    for i in range(3):
        one = settle_doubled_paths(whole, paths[[i]], weights, mixed[[i]])
        assert shared_out[i] == pytest.approx(one[0])


def test_each_state_is_held_by_its_own_pushes() -> None:
    """Of the trapezoidal rule, which has no points within: the first state is pushed at both, the second at one."""
    part = collocation("LGL", Mesh((0.0, 0.3, 1.0), (2, 2)))
    pushed = np.array([[True, True, False, True], [True, False, True, True]])
    held = _held_segments(part, pushed, np.ones((2, 4), dtype=bool))
    assert held.tolist() == [[True, False], [False, True]]


def arc_ends(part: Any) -> Array:
    """Shares of the phase at which its arcs begin and end."""
    return np.asarray(part.collocation.mesh.breaks)[list(part.collocation.mesh.anchors)]


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
    assert (
        solution.provenance["mesh"].startswith("first 2x(4..5)")
        and solution.provenance["scheme"] == solution.scheme
    )
    assert solution.constraint_values == pytest.approx(np.zeros(3), abs=1e-8)
    assert solution.multiplier("joined v") == pytest.approx(first.costate("v")(first.final_time), abs=1e-5)
    assert first.costate("v")(first.final_time, "left") == pytest.approx(
        second.costate("v")(second.initial_time), abs=1e-5
    )
    assert first.x(first.final_time) == pytest.approx(second.x(second.initial_time), abs=1e-8)


# --- times ------------------------------------------------------------------------------------------------


def test_times_of_points_by_their_arcs() -> None:
    part = collocation("LG", Mesh((0.0, 0.5, 1.0), (1, 1), (1,)))
    times, spans = _point_times(part, np.array([2.0, 5.0, 6.0]))
    assert times == pytest.approx([3.5, 5.5]) and spans.tolist() == [3.0, 1.0]


def test_a_mesh_ends_where_its_boundaries_went() -> None:
    mesh = Mesh((0.0, 0.25, 0.5, 1.0), (3, 4, 5), (2,))
    moved, breaks = _mesh_in_time(mesh, np.array([2.0, 5.0, 6.0]))
    assert (
        breaks == pytest.approx([2.0, 3.5, 5.0, 6.0]) and moved.degrees == (3, 4, 5) and moved.movable == (2,)
    )
    assert moved.breaks == pytest.approx((0.0, 0.375, 0.75, 1.0))
    fixed = Mesh((0.0, 0.25, 1.0), (3, 4))
    same, breaks = _mesh_in_time(fixed, np.array([2.0, 6.0]))
    assert same is fixed and breaks == pytest.approx([2.0, 3.0, 6.0])


@pytest.mark.parametrize("start", [0.0, 1e6, -1e6])
def test_segments_of_an_arc_that_has_vanished_still_increase(start: float) -> None:
    mesh = Mesh((0.0, 0.25, 0.5, 1.0), (3, 4, 5), (2,))
    _, breaks = _mesh_in_time(mesh, np.array([start, start, start + 1.0]))
    assert np.all(np.diff(breaks) > 0) and breaks[2] - start < 1e-4
    _, late = _mesh_in_time(mesh, np.array([0.0, start + 2e6, start + 2e6]))
    assert np.all(np.diff(late) > 0)  # the last arc ends far from the first time


def test_only_times_that_are_variables_have_multipliers() -> None:
    class Part:
        times = np.array([7, 3, 1])

    assert _time_multipliers(Part, np.arange(7.0)).tolist() == [0.0, 1.0]  # type: ignore[arg-type]
    Part.times = np.array([0, 3, 6])
    assert _time_multipliers(Part, 5 + np.arange(7.0)).tolist() == [5.0, 11.0]  # type: ignore[arg-type]


def test_optimised_parameters_replace_those_of_the_model() -> None:
    model = go.Model("m")
    x, u = model.state("x"), model.control("u")
    k, c = model.parameter("k", 2.0), model.parameter("c", [3.0, 4.0])
    model.ode({x: k * u + c[0] * c[1]})
    problem = go.Problem("p")
    leg = problem.phase("leg", model)
    problem.parameter("other")
    problem.parameter("c", 2)
    assert model_parameters(problem, leg, np.array([7.0, 8.0, 9.0])).tolist() == [2, 8, 9]
    assert leg.model.parameter_values.tolist() == [2, 3, 4]


# --- starts from guesses ----------------------------------------------------------------------------------


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
    attempt = Attempt.prepare(problem, {"leg": Mesh((0.0, 0.25, 1.0), (3, 3))}, scheme, None, SolverOptions())
    transcription = attempt.transcription
    x, part = start_from_guess(transcription, problem), transcription.parts["leg"]
    points = 1 + 4 * part.collocation.fractions
    assert x[part.collocation.boundary_states[:, 1]] == pytest.approx([2.0, 4.0])
    states = x[part.collocation.point_states]
    inner = ~np.isin(part.collocation.point_states[0], part.collocation.boundary_states[0])
    assert states[0, inner] == pytest.approx(2 * (points[inner] - 1)) and states[1, inner] == pytest.approx(
        2 * points[inner]
    )
    assert x[part.collocation.point_controls[0]] == pytest.approx(np.clip(3 - 2.5 * (points - 1) / 4, -1, 1))
    assert x[part.times[-1]] == 5.0 and part.times[0] >= transcription.n_variables
    assert x[part.collocation.boundary_states[:, 0]].tolist() == [0.0, 0.0]  # initial values are bounds


def test_movable_boundaries_start_at_their_fractions() -> None:
    problem = guessed()
    attempt = Attempt.prepare(
        problem, {"leg": Mesh((0.0, 0.25, 1.0), (3, 3), (1,))}, "LG", None, SolverOptions()
    )
    part = attempt.transcription.parts["leg"]
    assert start_from_guess(attempt.transcription, problem)[part.times[1:]].tolist() == [2.0, 5.0]


def test_integrals_that_are_variables_start_at_their_values() -> None:
    problem = go.Problem("product")
    model = go.Model("m")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
    leg.guess(x=(1.0, 1.0), u=(3.0, 3.0))
    problem.minimize(leg.integral(u**2) * leg.integral(x))
    attempt = Attempt.prepare(problem, {"leg": Mesh.uniform(2, 3)}, "LG", None, SolverOptions())
    places = attempt.transcription.integral_places
    assert places.size == 2 and np.sort(attempt.start.x[places]) == pytest.approx([2.0, 18.0])
    again = with_integrals(attempt.transcription, problem, attempt.start.x)
    assert again == pytest.approx(attempt.start.x) and again is not attempt.start.x


def test_the_trajectory_alone_becomes_the_guess(solved: Any) -> None:
    attempt, _, solution = solved
    problem = guess_from_solution(attempt.problem, solution)
    transcription = attempt.transcription
    x = start_from_guess(transcription, problem)
    start = start_from_solution(transcription, attempt.problem, solution, np.zeros(x.size))
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
            leg.flown.clipped(leg.initial_time)[:1]
        )


def test_a_guess_of_another_problem_is_refused(solved: Any) -> None:
    _, _, solution = solved
    with pytest.raises(go.ProblemError, match="the guess has no phase 'leg', only"):
        Attempt.prepare(cart(), {"leg": Mesh.uniform(2, 3)}, "LG", solution, SolverOptions())


# --- attempts ---------------------------------------------------------------------------------------------


def test_an_attempt_is_scaled_and_its_solver_kept() -> None:
    problem = guessed()
    meshes = {"leg": Mesh.uniform(2, 3)}
    begin = time.perf_counter()
    first = Attempt.prepare(problem, meshes, "LG", None, SolverOptions())
    assert 0 < first.build_s <= time.perf_counter() - begin
    second = Attempt.prepare(problem, meshes, "LG", None, SolverOptions())
    third = Attempt.prepare(problem, meshes, "LG", None, SolverOptions(tolerance=1e-6))
    assert (first.reused, second.reused, third.reused) == (False, True, False)
    assert first.solver is second.solver and first.solver is not third.solver
    assert not first.progress
    point, scaling = first.point(first.start), first.scaling
    box = first.transcription.variable_interval(problem)
    assert point.x0 * scaling.variables == pytest.approx(first.start.x)
    assert point.lam_x0 is None and point.lam_g0 is None
    finite = np.isfinite(box.lower)
    assert (point.lbx * scaling.variables)[finite] == pytest.approx(box.lower[finite])
    assert (point.ubx * scaling.variables)[finite] == pytest.approx(box.upper[finite])
    rows = first.transcription.row_interval(problem)
    finite = np.isfinite(rows.lower)
    assert point.lbg[finite] == pytest.approx((rows.lower * scaling.rows)[finite])
    held = np.array([3, 4])
    there = first.point(first.start, held=held, with_cost=False)
    assert there.lbx[held] == pytest.approx(point.x0[held]) and there.ubx[held] == pytest.approx(
        point.x0[held]
    )
    assert there.p[-1] == 0.0 and point.p[-1] == scaling.objective


def test_multipliers_are_scaled_as_the_program_is(solved: Any) -> None:
    attempt, result, solution = solved
    warm = Attempt.prepare(attempt.problem, {n: leg.mesh for n, leg in solution.phases.items()}, solution.scheme,
                           solution, SolverOptions())  # fmt: skip
    point = warm.point(warm.start)
    lam_x, lam_g = warm.start.lam_x, warm.start.lam_g
    assert point.lam_x0 == pytest.approx(lam_x * warm.scaling.variables * warm.scaling.objective)
    assert point.lam_g0 == pytest.approx(lam_g / warm.scaling.rows * warm.scaling.objective)
    assert warm.solver.solve(point).iterations < result.iterations


@pytest.mark.parametrize(
    ("movable", "asked", "careful"), [((), None, None), ((1,), None, True), ((1,), False, False)]
)
def test_short_arcs_are_pivoted_with_care(movable: Any, asked: Any, careful: Any) -> None:
    mesh = Mesh((0.0, 0.5, 1.0), (3, 3), movable)
    attempt = Attempt.prepare(guessed(), {"leg": mesh}, "LG", None, SolverOptions(careful_pivoting=asked))
    assert attempt.solver.options.careful_pivoting is careful and attempt.options.careful_pivoting is asked


def test_a_fixed_variable_sits_exactly_at_its_value() -> None:
    problem = guessed().with_fixed_arcs(arcs=[[ArcKind.UPPER, ArcKind.INTERIOR]])
    attempt = Attempt.prepare(problem, {"leg": Mesh.uniform(2, 3)}, "LG", None, SolverOptions())
    point = attempt.point(attempt.start)
    result = attempt.solver.solve(point)
    off = np.full(result.x.size, 1e-9)
    solution = attempt.solution(replace(result, x=result.x + off))
    assert solution.phase().u.values[0].tolist() == [[1.0, 1.0, 1.0]]
    assert solution.phase().x(1.0).tolist() == [0.0, 0.0]
