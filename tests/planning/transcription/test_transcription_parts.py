"""The program of a problem, piece by piece: meshes, places, rows, held arcs, scales, and its derivatives."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from testing.constructed_solutions import cart, interval
from testing.internals import (
    DEFAULT_MESH,
    NEARBY_SHIFT,
    SCHEMES,
    FixedArcs,
    Interval,
    PhaseCollocation,
    Scheme,
    SmoothControl,
    Transcription,
    build_polynomial_control_constraints,
    check_number_of_arc_segments,
    choose_row_scales,
    choose_variable_scales,
    get_point_family,
    impose_control_limits_on_arcs,
    impose_path_limits_on_arcs,
    impose_state_limits_on_arcs,
)

import gnc_opt as go
from gnc_opt.errors import ArgumentError, ProblemError
from gnc_opt.planning import ArcKind, Mesh

LOW, FREE, UP, RELEASED = ArcKind.LOWER, ArcKind.INTERIOR, ArcKind.UPPER, ArcKind.RELEASED
UNEVEN = Mesh((0.0, 0.1, 0.4, 0.5, 1.0), (2, 3, 4, 2), (2,))
"""Four segments, the boundary at 0.4 movable: arcs of 0.4 and 0.6."""


def test_a_mesh_in_fractions_of_the_phase_and_of_its_arcs() -> None:
    assert (UNEVEN.segments, UNEVEN.size, UNEVEN.point_offsets) == (4, 11, (0, 2, 5, 9, 11))
    assert UNEVEN.segment_widths == pytest.approx([0.1, 0.3, 0.1, 0.5]) and UNEVEN.arc_breaks == (0, 2, 4)
    assert UNEVEN.segment_arcs.tolist() == [0, 0, 1, 1]
    assert UNEVEN.arc_starts == pytest.approx([0.0, 0.25, 0.0, 1 / 6])
    assert UNEVEN.arc_widths == pytest.approx([0.25, 0.75, 1 / 6, 5 / 6])
    fixed = Mesh(UNEVEN.breaks, UNEVEN.degrees)
    assert fixed.arc_breaks == (0, 4) and fixed.arc_widths == pytest.approx(fixed.segment_widths)
    assert fixed.arc_starts == pytest.approx([0, 0.1, 0.4, 0.5]) and fixed.segment_arcs.tolist() == [0] * 4


@pytest.mark.parametrize(
    ("mesh", "text"),
    [
        (Mesh.uniform(4, 3), "4x3"),
        (UNEVEN, "4x(2..4) (free breakpoints)"),
        (Mesh((0.0, 0.3, 1.0), (3, 3)), "2x3 (uneven)"),
        (Mesh.parse(" 20 x 3 "), "20x3"),
        (DEFAULT_MESH, "20x4"),
        (Mesh.at_times([2.0, 3.0, 4.0], [2, 5]), "2x(2..5)"),
    ],
)
def test_meshes_in_words(mesh: Mesh, text: str) -> None:
    assert str(mesh) == text


def test_meshes_at_times() -> None:
    mesh = Mesh.at_times([10.0, 11.0, 14.0], 3, movable=True)
    assert mesh.breaks == (0.0, 0.25, 1.0) and mesh.degrees == (3, 3) and mesh.movable == (1,)
    assert Mesh.at_times([0.0, 1.0, 3.0], [2, 4]).movable == ()
    assert Mesh.at_times([0.0, 1.0], 2, movable=True).movable == ()
    assert Mesh((-1e-13, 0.5, 1 + 1e-13), (2, 2), (1, 1)).breaks == (0.0, 0.5, 1.0)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: Mesh((0.0, 0.5, 0.5, 1.0), (2, 2, 2)), "increase"),
        (lambda: Mesh((0.0,), ()), "two or more"),
        (lambda: Mesh((0.1, 1.0), (2,)), "from 0.1 to 1"),
        (lambda: Mesh((0.0, 0.9), (2,)), "from 0 to 0.9"),
        (lambda: Mesh((0.0, 1.0), (2, 2)), "1 segments, but 2 degrees"),
        (lambda: Mesh((0.0, 1.0), (0,)), "integers >= 1"),
        (lambda: Mesh((0.0, 1.0), (2.5,)), "integers >= 1"),
        (lambda: Mesh((0.0, 1.0), (np.inf,)), "integers >= 1"),  # type: ignore[arg-type]
        (lambda: Mesh((0.0, 0.5, 1.0), (2, 2), (2,)), "interior breaks 1 to 1"),
        (lambda: Mesh((0.0, 0.5, 1.0), (2, 2), (0,)), "interior"),
        (lambda: Mesh.uniform(0, 2), "number of segments"),
        (lambda: Mesh.parse("3"), "SEGMENTSxDEGREE"),
        (lambda: Mesh.parse("3x2.5"), "20x3"),
        (lambda: Mesh.parse(3), "not understood"),
        (lambda: Mesh.at_times([1.0, 1.0], 2), "increasing"),  # type: ignore[arg-type]
        (lambda: Mesh.at_times([1.0], 2), "two or more"),
        (lambda: Mesh.at_times([0.0, np.inf], 2), "finite"),
        (lambda: Mesh.at_times([0.0, 1.0], 2, movable=1), "movable=True"),  # type: ignore[arg-type]
    ],
)
def test_meshes_that_are_none_are_refused(wrong: Any, message: str) -> None:
    with pytest.raises((ProblemError, ArgumentError), match=message):
        wrong()


def collocation(
    scheme: Scheme, mesh: Mesh = UNEVEN, n: int = 2, m: int = 1, paths: int = 0, first: int = 0, row: int = 0
) -> PhaseCollocation:
    return PhaseCollocation(scheme, mesh, n, m, paths, first, row)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_every_variable_and_row_has_one_place_and_a_name(scheme: Scheme) -> None:
    part = collocation(scheme, n=2, m=2, paths=3, first=10, row=20)
    places = np.unique(
        np.concatenate([part.boundary_states.ravel(), part.point_states.ravel(), part.point_controls.ravel()])
    )
    assert places.tolist() == list(range(10, 10 + part.n_variables))
    rows = np.concatenate([*[r.ravel() for r in part.dynamics_rows], part.path_rows.ravel()])
    assert sorted(rows) == list(range(20, 20 + part.n_rows))
    assert part.n_dynamics_rows == 2 * (11 + 4 * get_point_family(scheme).extra_rows)
    assert part.n_rows == part.n_dynamics_rows + 33
    labels = part.list_constraint_row_labels("leg", ("x", "y"), ("a", "b", "c"))
    assert len(labels) == part.n_rows and labels[part.dynamics_rows[2][1, 0] - 20].startswith(
        "y defect, phase leg, segment 3"
    )
    assert labels[part.path_rows[2, 4] - 20] == "path c, phase leg, segment 2, point 3"
    names = part.list_variable_labels("leg", ("x", "y"), ("u", "w"))
    assert len(names) == part.n_variables and all(names)
    assert names[part.boundary_states[1, 0] - 10] == "y, phase leg, start"
    assert names[part.boundary_states[0, 2] - 10] == "x, phase leg, end of segment 2"
    assert names[part.point_controls[1, 5] - 10] == "w, phase leg, segment 3, point 1"
    assert names[part.point_states[0, 3] - 10] == "x, phase leg, segment 2, point 2"


@pytest.mark.parametrize("scheme", SCHEMES)
def test_rows_vanish_on_polynomials_and_only_there(scheme: Scheme) -> None:
    """x = t^2 / 2 over arcs of 4 s and 6 s, with rates times the duration of the arc, on every node."""
    part = collocation(scheme, n=1, m=0)
    spans, starts = np.array([4.0, 6.0]), np.array([0.0, 4.0])
    x = np.zeros(part.n_variables)
    t = starts[part.point_arc_indices] + part.normalised_times_in_arcs * spans[part.point_arc_indices]
    x[part.boundary_states[0]] = 0.5 * (10 * np.asarray(UNEVEN.breaks)) ** 2
    x[part.point_states[0]] = 0.5 * t**2
    rows, columns, values = part.linear_dynamics_nonzeros
    total = np.zeros(part.n_rows)
    np.add.at(total, rows, values * x[columns])
    rows, columns, values = part.list_quadrature_nonzeros(1, np.array([0]), np.zeros(0, dtype=np.int64))
    np.add.at(total, rows, values * (t * spans[part.point_arc_indices])[columns])
    assert total == pytest.approx(0.0, abs=1e-12)
    total = np.zeros(part.n_rows)
    np.add.at(total, rows, values * (2 * t * spans[part.point_arc_indices])[columns])
    assert np.max(np.abs(total)) > 0.1


def box(size: int) -> Interval:
    return Interval(np.full(size, -7.0), np.full(size, 7.0))


def test_a_phase_without_controls_has_none_to_hold() -> None:
    part = collocation("LG", Mesh((0.0, 0.3, 1.0), (2, 1)), n=1, m=0)
    found = box(part.n_variables)
    impose_control_limits_on_arcs(found, FixedArcs(()), interval([], []), part)
    assert np.all(found.lower == -7) and np.all(found.upper == 7)


def test_controls_and_paths_are_held_at_the_points_of_their_segments() -> None:
    part = collocation("LG", Mesh((0.0, 0.3, 0.6, 1.0), (2, 1, 1)), n=1, m=2, paths=1)
    found = box(part.n_variables)
    impose_control_limits_on_arcs(
        found, FixedArcs(((LOW, FREE, UP), (RELEASED, UP, FREE))), interval([-1, -2], [3, 4]), part
    )
    assert found.lower[part.point_controls].tolist() == [[-1, -1, -7, 3], [-np.inf, -np.inf, 4, -7]]
    assert found.upper[part.point_controls].tolist() == [[-1, -1, 7, 3], [np.inf, np.inf, 4, 7]]
    rows = box(part.n_rows)
    impose_path_limits_on_arcs(
        rows, FixedArcs(((FREE,) * 3,) * 2, paths=((UP, RELEASED, LOW),)), interval([-5], [6]), part
    )
    assert rows.lower[part.path_rows].tolist() == [[6, 6, -np.inf, -5]]
    assert rows.upper[part.path_rows].tolist() == [[6, 6, np.inf, -5]]
    untouched = box(part.n_rows)
    impose_path_limits_on_arcs(untouched, FixedArcs(((FREE,) * 3,) * 2), interval([-5], [6]), part)
    assert np.all(untouched.lower == -7)


def test_states_are_held_at_the_start_and_the_points_of_their_arc() -> None:
    """The ends of held segments follow; the start of an arc is held once, where another limit begins again."""
    part = collocation("LG", Mesh((0.0, 0.2, 0.4, 0.6, 0.8, 1.0), (1, 1, 1, 1, 1)), n=1)
    found, (leg, _) = box(part.n_variables), stated()[1]
    impose_state_limits_on_arcs(
        found, leg, FixedArcs(((FREE,) * 5,), states=((FREE, UP, UP, LOW, FREE),)), part
    )
    assert found.lower[part.point_states].tolist() == [[-7, 3, 3, -1, -7]]
    assert found.upper[part.point_states][0, 3] == -1
    assert found.lower[part.boundary_states].tolist() == [[-7, 3, -np.inf, -1, -np.inf, -7]]
    assert found.upper[part.boundary_states].tolist() == [[7, 3, np.inf, -1, np.inf, 7]]
    first = box(part.n_variables)
    impose_state_limits_on_arcs(
        first, leg, FixedArcs(((FREE,) * 5,), states=((LOW, FREE, FREE, FREE, FREE),)), part
    )
    assert first.lower[part.boundary_states].tolist() == [[-1, -np.inf, -7, -7, -7, -7]]
    loose = box(part.n_variables)
    impose_state_limits_on_arcs(
        loose, leg, FixedArcs(((FREE,) * 5,), states=((RELEASED, RELEASED, FREE, FREE, RELEASED),)), part
    )
    assert loose.lower[part.boundary_states].tolist() == [[-7, -np.inf, -np.inf, -7, -np.inf, -7]]


@pytest.mark.parametrize(
    ("before", "jump", "start"),
    [(LOW, 0.0, -np.inf), (UP, 0.0, -1), (FREE, 0.0, -1), (LOW, 0.5, -1), (None, 0.0, -1)],
)
def test_an_arc_that_goes_on_from_the_phase_before_has_begun_there(
    before: ArcKind | None, jump: float, start: float
) -> None:
    """Its state is handed over on the bound; held at the start once more it would leave the multipliers open."""
    problem, (first, second) = stated()
    problem.link(first, second, jump={"x": jump})
    if before is not None:
        first.hold([[FREE, FREE]], states=[[FREE, before]])
    part = collocation("LG", Mesh.uniform(2, 1), n=1)
    found = box(part.n_variables)
    impose_state_limits_on_arcs(found, second, FixedArcs(((FREE,) * 2,), states=((LOW, LOW),)), part)
    assert found.lower[part.boundary_states].tolist() == [[start, -np.inf, -np.inf]]


def stated() -> tuple[go.Problem, tuple[go.Phase, go.Phase]]:
    """A problem with two phases of a state between -1 and 3."""
    model = go.Model("one")
    model.ode({model.state("x"): model.control("u")})
    problem = go.Problem("held")
    legs = problem.phase("first", model), problem.phase("second", model)
    for leg in legs:
        leg.bounds(x=(-1, 3))
    return problem, legs


def test_arcs_of_another_number_of_segments_are_refused() -> None:
    problem = cart().with_fixed_arcs(arcs=[[0, 0]])
    leg = problem.get_phase()
    check_number_of_arc_segments(leg, collocation("LG", Mesh.uniform(2, 3)))
    check_number_of_arc_segments(cart().get_phase(), collocation("LG", Mesh.uniform(3, 3)))
    with pytest.raises(ProblemError, match="given for 2 segments, but its mesh has 3"):
        check_number_of_arc_segments(leg, collocation("LG", Mesh.uniform(3, 3)))


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_smooth_rows_vanish_on_polynomials_in_time_alone(degree: int) -> None:
    """Over the last two segments of the first arc and the whole of it; they are orthonormal."""
    part = collocation("LG", Mesh((0.0, 0.1, 0.4, 0.5, 1.0), (2, 3, 4, 2), (3,)), m=2)
    columns, rows = build_polynomial_control_constraints(SmoothControl(1, 1, 3, degree), part)
    assert columns.tolist() == part.point_controls[1, 2:9].tolist() and rows.shape == (7 - degree - 1, 7)
    t = part.normalised_point_times[2:9]
    for power in range(degree + 1):
        assert rows @ t**power == pytest.approx(0.0, abs=1e-12)
    assert np.max(np.abs(rows @ t ** (degree + 1))) > 1e-4
    assert rows @ rows.T == pytest.approx(np.eye(rows.shape[0]))


def problem_of_all() -> go.Problem:
    problem = cart()
    leg = problem.get_phase()
    leg.time((0.5, 1.0), (2.0, 9.0), duration=(0.25, 5.0))
    leg.bounds(q=(-3.0, 4.0), a=(-8.0, 6.0))
    leg.final(q=(3.5, 9.0))
    tight = problem.parameter("tight", lower=0.5, upper=2.0)
    problem.constrain("sum", leg.final_state("q") + leg.initial_state("v") + tight, upper=7.0)
    return problem


def test_bounds_of_all_variables_and_rows() -> None:
    problem = problem_of_all()
    mesh = Mesh((0.0, 0.5, 1.0), (2, 3), (1,))
    program = Transcription(problem, {"leg": mesh}, "LG")
    part, found = program.parts["leg"].collocation, program.get_variable_bounds(problem)
    assert found.lower[part.boundary_states].tolist() == [[0, -3, 3.5], [0, -np.inf, -np.inf]]
    assert found.upper[part.boundary_states].tolist() == [[0, 4, 4], [0, np.inf, np.inf]]
    assert set(found.lower[part.point_controls].ravel()) == {-8.0} and set(
        found.upper[part.point_controls].ravel()
    ) == {6.0}
    times = program.parts["leg"].times
    assert times.size == 3 and np.all(times < program.n_variables)
    assert found.lower[times].tolist() == [0.5, -np.inf, 2.0] and found.upper[times].tolist() == [
        1.0,
        np.inf,
        9.0,
    ]
    assert found.lower[program.parameter_indices].tolist() == [0.5] and found.upper[
        program.parameter_indices
    ].tolist() == [2.0]
    rows = program.get_constraint_bounds(problem)
    dynamics = np.concatenate([r.ravel() for r in part.dynamics_rows])
    assert not rows.lower[dynamics].any() and not rows.upper[dynamics].any()
    assert set(rows.upper[part.path_rows[0]]) == {100.0} and set(rows.lower[part.path_rows[1]]) == {-50.0}
    ends = program.boundary_constraint_row_indices
    assert list(ends) == [
        "duration of phase leg",
        "length of arc 1, phase leg",
        "length of arc 2, phase leg",
        "constraint sum",
    ]
    assert [rows.lower[i] for i in ends.values()] == [0.25, 1e-9, 1e-9, -np.inf]
    assert [rows.upper[i] for i in ends.values()] == [5.0, np.inf, np.inf, 7.0]
    assert program.constraint_rows.tolist() == [ends["constraint sum"]]
    assert len(program.constraint_row_labels) == program.n_constraints
    assert program.constraint_row_labels[-1] == "constraint sum"
    assert len(program.variable_labels) == program.n_variables
    assert program.variable_labels[-4:] == (
        "initial time, phase leg",
        "boundary 1 time, phase leg",
        "final time, phase leg",
        "parameter tight",
    )
    lam = np.arange(float(program.n_constraints))
    assert program.get_duration_multiplier("leg", lam) == ends["duration of phase leg"]
    assert program.list_fixed_phase_times(problem).tolist() == [0.0, 0.0]


def test_a_bound_that_rounding_crosses_is_met() -> None:
    problem = cart()
    leg = problem.get_phase()
    leg.bounds(q=(-3.0, 4.0))
    leg.final(q=4.0 + 1e-15)
    program = Transcription(problem, {"leg": Mesh.uniform(1, 2)}, "LG")
    found = program.get_variable_bounds(problem)
    assert np.all(found.lower <= found.upper)


def test_variables_are_scaled_by_what_the_user_says_or_by_what_is_found() -> None:
    problem = problem_of_all().with_scale(v=0.25)
    problem.get_phase().guess(time=(0.5, -6.0 + 12.5), q=(0.0, 3.0))
    program = Transcription(problem, {"leg": Mesh.uniform(2, 2)}, "LG")
    start = np.zeros(program.n_variables)
    start[program.parameter_indices] = 1.5
    found, usual = (choose_variable_scales(program, problem, start, overridden=o) for o in (True, False))
    part = program.parts["leg"].collocation
    assert found[part.boundary_states].tolist() == [[4.0] * 3, [0.25] * 3] and set(
        found[part.point_states][1]
    ) == {0.25}
    assert set(found[part.point_controls].ravel()) == {8.0} and found[program.parameter_indices].tolist() == [
        2.0
    ]
    assert found[program.parts["leg"].times] == pytest.approx([6.5, 6.5])
    assert usual[part.boundary_states[1, 0]] != 0.25 and np.array_equal(
        np.delete(usual, np.r_[part.boundary_states[1], part.point_states[1]]),
        np.delete(found, np.r_[part.boundary_states[1], part.point_states[1]]),
    )


def test_rows_are_scaled_by_their_states_or_by_their_slopes() -> None:
    """By what the derivatives are at the guess and near it; scales of the user do not move the place that is near.

    q >= -50 is far away: by a tenth of the distance, at the guess or at q (1 + 0.1 c), c the cosine of its place.
    """
    problem = problem_of_all()
    problem.get_phase().guess(time=(0.5, 6.5), q=(0.0, 3.0), a=(2.0, 2.0))
    program = Transcription(problem, {"leg": Mesh.uniform(2, 2)}, "LG")
    start = np.linspace(0.5, 1.5, program.n_variables)
    scales = choose_variable_scales(program, problem, start)
    rows, objective = choose_row_scales(program, problem, start, scales)
    part = program.parts["leg"].collocation
    for k in range(2):
        assert rows[part.dynamics_rows[k]] == pytest.approx(
            1 / scales[part.boundary_states[:, [0]]] * np.ones((2, 3))
        )
    mixed, pure = rows[part.path_rows]
    assert mixed == pytest.approx(1 / max(scales[part.point_states[1, 0]], 8.0))
    places = part.point_states[0]
    beside = 1 + NEARBY_SHIFT * np.cos(np.pi * (3 - np.sqrt(5)) * places)
    assert pure == pytest.approx(10.0 / (50.0 + start[places] * np.maximum(1.0, beside)))
    assert objective > 0 and NEARBY_SHIFT == 0.1
    again = choose_row_scales(program, problem.with_scale(v=1e-3), start, scales)
    assert again[1] == pytest.approx(objective) and again[0] == pytest.approx(rows)
