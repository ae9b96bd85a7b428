"""The program of a problem, piece by piece: meshes, places, rows, held arcs, scales, and its derivatives."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.constructed_solutions import cart, interval

import gnc_opt as go
from gnc_opt.errors import ArgumentError, ProblemError, UnknownNameError
from gnc_opt.planning import ArcKind, Mesh
from gnc_opt.planning.nlp.program import NlpProblem, full_hessian, joint_jacobian
from gnc_opt.planning.nlp.separable import PointBlock, PointFunction, SeparableProgram
from gnc_opt.planning.problem.arcs import Held, Smooth
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.planning.transcription.arc_constraints import (
    check_segments,
    hold_controls,
    hold_paths,
    hold_states,
    smooth_entries,
    smooth_rows,
)
from gnc_opt.planning.transcription.collocation import PhaseCollocation, weight_matrix
from gnc_opt.planning.transcription.mesh import DEFAULT_MESH, read_meshes
from gnc_opt.planning.transcription.quadrature import collocation_rule
from gnc_opt.planning.transcription.scaling import NEARBY, scale_rows, scale_variables
from gnc_opt.planning.transcription.scheme import SCHEMES, Scheme, family_of
from gnc_opt.planning.transcription.transcription import CACHED_PROGRAMS, Transcription, transcribe

LOW, FREE, UP, RELEASED = ArcKind.LOWER, ArcKind.INTERIOR, ArcKind.UPPER, ArcKind.RELEASED
UNEVEN = Mesh((0.0, 0.1, 0.4, 0.5, 1.0), (2, 3, 4, 2), (2,))
"""Four segments, the boundary at 0.4 movable: arcs of 0.4 and 0.6."""


# --- meshes -----------------------------------------------------------------------------------------------


def test_a_mesh_in_fractions_of_the_phase_and_of_its_arcs() -> None:
    assert (UNEVEN.segments, UNEVEN.size, UNEVEN.offsets) == (4, 11, (0, 2, 5, 9, 11))
    assert UNEVEN.widths == pytest.approx([0.1, 0.3, 0.1, 0.5]) and UNEVEN.anchors == (0, 2, 4)
    assert UNEVEN.segment_arcs.tolist() == [0, 0, 1, 1]
    assert UNEVEN.arc_starts == pytest.approx([0.0, 0.25, 0.0, 1 / 6])
    assert UNEVEN.arc_widths == pytest.approx([0.25, 0.75, 1 / 6, 5 / 6])
    fixed = Mesh(UNEVEN.breaks, UNEVEN.degrees)
    assert fixed.anchors == (0, 4) and fixed.arc_widths == pytest.approx(fixed.widths)
    assert fixed.arc_starts == pytest.approx([0, 0.1, 0.4, 0.5]) and fixed.segment_arcs.tolist() == [0] * 4


@pytest.mark.parametrize(
    ("mesh", "text"),
    [
        (Mesh.uniform(4, 3), "4x3"),
        (UNEVEN, "4x(2..4) (movable)"),
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
    assert (
        Mesh.at_times([0.0, 1.0, 3.0], [2, 4]).movable == ()
        and Mesh.at_times([0.0, 1.0], 2, movable=True).movable == ()
    )
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


def test_meshes_for_every_phase() -> None:
    one = Mesh.uniform(2, 3)
    assert read_meshes(None, ["a", "b"], "p") == {"a": DEFAULT_MESH, "b": DEFAULT_MESH}
    assert read_meshes("2x3", ["a"], "p") == {"a": one} == read_meshes(one, ["a"], "p")
    assert read_meshes({"a": one, "b": "4x2"}, ["a", "b"], "p")["b"] == Mesh.uniform(4, 2)
    with pytest.raises(ProblemError, match="the mesh of problem 'p' lacks phase 'b'"):
        read_meshes({"a": one}, ["a", "b"], "p")
    with pytest.raises(ProblemError, match="is not a mesh"):
        read_meshes(3, ["a"], "p")  # type: ignore[arg-type]


# --- places -----------------------------------------------------------------------------------------------


def collocation(
    scheme: Scheme, mesh: Mesh = UNEVEN, n: int = 2, m: int = 1, paths: int = 0, first: int = 0, row: int = 0
) -> PhaseCollocation:
    return PhaseCollocation(scheme, mesh, n, m, paths, first, row)


@pytest.mark.parametrize(
    ("scheme", "degrees", "boundary", "points", "controls"),
    [
        ("LG", (2, 1), [5, 10, 13], [6, 8, 11], [7, 9, 12]),
        ("LGR", (2, 1), [5, 9, 11], [5, 7, 9], [6, 8, 10]),
        ("LGL", (2, 3), [5, 7, 12], [5, 7, 7, 10, 12], [6, 8, 9, 11, 13]),
    ],
)
def test_variables_stand_in_the_order_of_time(
    scheme: Scheme, degrees: tuple[int, ...], boundary: list[int], points: list[int], controls: list[int]
) -> None:
    """One state, one control: they alternate, and neighbouring segments share the state at their boundary."""
    part = collocation(scheme, Mesh((0.0, 0.5, 1.0), degrees), n=1, first=5)
    assert part.boundary_states.tolist() == [boundary] and part.point_states.tolist() == [points]
    assert part.point_controls.tolist() == [controls]
    assert part.n_variables == max(boundary[-1], controls[-1]) + 1 - 5


@pytest.mark.parametrize("scheme", SCHEMES)
def test_every_variable_and_row_has_one_place_and_a_name(scheme: Scheme) -> None:
    part = collocation(scheme, n=2, m=2, paths=3, first=10, row=20)
    places = np.unique(
        np.concatenate([part.boundary_states.ravel(), part.point_states.ravel(), part.point_controls.ravel()])
    )
    assert places.tolist() == list(range(10, 10 + part.n_variables))
    rows = np.concatenate([*[r.ravel() for r in part.dynamics_rows], part.path_rows.ravel()])
    assert sorted(rows) == list(range(20, 20 + part.n_rows))
    assert (
        part.n_dynamics_rows == 2 * (11 + 4 * family_of(scheme).extra_rows)
        and part.n_rows == part.n_dynamics_rows + 33
    )
    labels = part.row_labels("leg", ("x", "y"), ("a", "b", "c"))
    assert len(labels) == part.n_rows and labels[part.dynamics_rows[2][1, 0] - 20].startswith(
        "y defect, phase leg, segment 3"
    )
    assert labels[part.path_rows[2, 4] - 20] == "path c, phase leg, segment 2, point 3"
    names = part.variable_labels("leg", ("x", "y"), ("u", "w"))
    assert len(names) == part.n_variables and all(names)
    assert names[part.boundary_states[1, 0] - 10] == "y, phase leg, start"
    assert names[part.boundary_states[0, 2] - 10] == "x, phase leg, end of segment 2"
    assert names[part.point_controls[1, 5] - 10] == "w, phase leg, segment 3, point 1"
    assert names[part.point_states[0, 3] - 10] == "x, phase leg, segment 2, point 2"


@pytest.mark.parametrize("scheme", SCHEMES)
def test_times_and_weights_of_points(scheme: Scheme) -> None:
    part = collocation(scheme)
    tau = [collocation_rule(scheme, n) for n in UNEVEN.degrees]
    assert part.fractions[:2] == pytest.approx(0.05 * (1 + tau[0].points))
    assert part.arc_fractions[2:5] == pytest.approx(0.25 + 0.375 * (1 + tau[1].points))
    assert part.point_arcs.tolist() == [0] * 5 + [1] * 6
    assert part.quadrature[:5].sum() == pytest.approx(1.0) == part.quadrature[5:].sum()
    assert part.quadrature[2:5] == pytest.approx(0.375 * tau[1].weights)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_rows_vanish_on_polynomials_and_only_there(scheme: Scheme) -> None:
    """x = t^2 / 2 over arcs of 4 s and 6 s, with rates times the duration of the arc, on every node."""
    part = collocation(scheme, n=1, m=0)
    spans, starts = np.array([4.0, 6.0]), np.array([0.0, 4.0])
    x = np.zeros(part.n_variables)
    t = starts[part.point_arcs] + part.arc_fractions * spans[part.point_arcs]
    x[part.boundary_states[0]] = 0.5 * (10 * np.asarray(UNEVEN.breaks)) ** 2
    x[part.point_states[0]] = 0.5 * t**2
    rows, columns, values = part.linear
    total = np.zeros(part.n_rows)
    np.add.at(total, rows, values * x[columns])
    rows, columns, values = part.weights(1, np.array([0]), np.zeros(0, dtype=np.int64))
    np.add.at(total, rows, values * (t * spans[part.point_arcs])[columns])
    assert total == pytest.approx(0.0, abs=1e-12)
    total = np.zeros(part.n_rows)
    np.add.at(total, rows, values * (2 * t * spans[part.point_arcs])[columns])
    assert np.max(np.abs(total)) > 0.1


def test_path_rows_take_their_own_outputs() -> None:
    part = collocation("LG", Mesh((0.0, 0.5, 1.0), (2, 1)), n=1, paths=2, row=7)
    rows, columns, values = part.weights(3, np.array([0]), np.array([1, 2]))
    entries = dict(zip(rows.tolist(), zip(columns.tolist(), values.tolist(), strict=True), strict=False))
    first = 7 + part.n_dynamics_rows
    assert [entries[first + i] for i in range(6)] == [
        (1, 1.0),
        (2, 1.0),
        (4, 1.0),
        (5, 1.0),
        (7, 1.0),
        (8, 1.0),
    ]
    matrix = weight_matrix(2, 3, ([0, 0, 1], [1, 1, 2], [1.0, 2.0, 5.0]), ([1], [0], [4.0]))
    assert matrix.toarray().tolist() == [[0, 3, 0], [4, 0, 5]]


def test_families_of_points() -> None:
    gauss, radau, lobatto = (family_of(s) for s in SCHEMES)
    assert [f.has_end_row for f in (gauss, radau, lobatto)] == [True, False, False]
    assert [f.symmetric for f in (gauss, radau, lobatto)] == [True, False, True]
    assert [f.fewest for f in (gauss, radau, lobatto)] == [1, 1, 2]
    assert [gauss.row_place(i, 2) for i in range(3)] == ["point 1", "point 2", "end"]
    assert radau.row_place(1, 2) == "point 2" and lobatto.row_place(0, 3) == "point 2"
    for wrong, hint in (
        ("gauss", "did you mean 'LG'"),
        ("lgl", "'LGL'"),
        ("xyz", "choose LG"),
        (3, "choose LG"),
    ):
        with pytest.raises(ArgumentError, match=hint):
            family_of(wrong)  # type: ignore[arg-type]


# --- held arcs --------------------------------------------------------------------------------------------


def box(size: int) -> Interval:
    return Interval(np.full(size, -7.0), np.full(size, 7.0))


def test_a_phase_without_controls_has_none_to_hold() -> None:
    part = collocation("LG", Mesh((0.0, 0.3, 1.0), (2, 1)), n=1, m=0)
    found = box(part.n_variables)
    hold_controls(found, Held(()), interval([], []), part)
    assert np.all(found.lower == -7) and np.all(found.upper == 7)


def test_eased_controls_may_leave_their_bounds_by_a_tenth_of_their_range() -> None:
    part = collocation("LG", Mesh((0.0, 0.3, 1.0), (2, 1)), n=1, m=2)
    found = box(part.n_variables)
    hold_controls(found, Held(((ArcKind.EASED, FREE), (FREE, FREE))), interval([-7, -7], [7, 7]), part)
    np.testing.assert_allclose(found.lower[part.point_controls], [[-8.4, -8.4, -7], [-7] * 3])
    np.testing.assert_allclose(found.upper[part.point_controls], [[8.4, 8.4, 7], [7] * 3])


def test_controls_and_paths_are_held_at_the_points_of_their_segments() -> None:
    part = collocation("LG", Mesh((0.0, 0.3, 0.6, 1.0), (2, 1, 1)), n=1, m=2, paths=1)
    found = box(part.n_variables)
    hold_controls(found, Held(((LOW, FREE, UP), (RELEASED, UP, FREE))), interval([-1, -2], [3, 4]), part)
    assert found.lower[part.point_controls].tolist() == [[-1, -1, -7, 3], [-np.inf, -np.inf, 4, -7]]
    assert found.upper[part.point_controls].tolist() == [[-1, -1, 7, 3], [np.inf, np.inf, 4, 7]]
    rows = box(part.n_rows)
    hold_paths(rows, Held(((FREE,) * 3,) * 2, paths=((UP, RELEASED, LOW),)), interval([-5], [6]), part)
    assert rows.lower[part.path_rows].tolist() == [[6, 6, -np.inf, -5]]
    assert rows.upper[part.path_rows].tolist() == [[6, 6, np.inf, -5]]
    untouched = box(part.n_rows)
    hold_paths(untouched, Held(((FREE,) * 3,) * 2), interval([-5], [6]), part)
    assert np.all(untouched.lower == -7)


def test_states_are_held_at_the_start_and_the_points_of_their_arc() -> None:
    """The ends of held segments follow; the start of an arc is held once, where another limit begins again."""
    part = collocation("LG", Mesh((0.0, 0.2, 0.4, 0.6, 0.8, 1.0), (1, 1, 1, 1, 1)), n=1)
    found, (leg, _) = box(part.n_variables), stated()[1]
    hold_states(found, leg, Held(((FREE,) * 5,), states=((FREE, UP, UP, LOW, FREE),)), part)
    assert (
        found.lower[part.point_states].tolist() == [[-7, 3, 3, -1, -7]]
        and found.upper[part.point_states][0, 3] == -1
    )
    assert found.lower[part.boundary_states].tolist() == [[-7, 3, -np.inf, -1, -np.inf, -7]]
    assert found.upper[part.boundary_states].tolist() == [[7, 3, np.inf, -1, np.inf, 7]]
    first = box(part.n_variables)
    hold_states(first, leg, Held(((FREE,) * 5,), states=((LOW, FREE, FREE, FREE, FREE),)), part)
    assert first.lower[part.boundary_states].tolist() == [[-1, -np.inf, -7, -7, -7, -7]]


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
    hold_states(found, second, Held(((FREE,) * 2,), states=((LOW, LOW),)), part)
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
    check_segments(leg, collocation("LG", Mesh.uniform(2, 3)))
    check_segments(cart().get_phase(), collocation("LG", Mesh.uniform(3, 3)))
    with pytest.raises(ProblemError, match="given for 2 segments, but its mesh has 3"):
        check_segments(leg, collocation("LG", Mesh.uniform(3, 3)))


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_smooth_rows_vanish_on_polynomials_in_time_alone(degree: int) -> None:
    """Over the last two segments of the first arc and the whole of it; they are orthonormal."""
    part = collocation("LG", Mesh((0.0, 0.1, 0.4, 0.5, 1.0), (2, 3, 4, 2), (3,)), m=2)
    columns, rows = smooth_rows(Smooth(1, 1, 3, degree), part)
    assert columns.tolist() == part.point_controls[1, 2:9].tolist() and rows.shape == (7 - degree - 1, 7)
    t = part.fractions[2:9]
    for power in range(degree + 1):
        assert rows @ t**power == pytest.approx(0.0, abs=1e-12)
    assert np.max(np.abs(rows @ t ** (degree + 1))) > 1e-4
    assert rows @ rows.T == pytest.approx(np.eye(rows.shape[0]))


def test_smooth_rows_are_numbered_one_after_another() -> None:
    first = (np.array([5, 6]), np.array([[1.0, 2.0]]))
    second = (np.array([8, 9, 7]), np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]))
    rows, columns, values = smooth_entries([first, second], 100)
    assert rows.tolist() == [100, 100, 101, 101, 101, 102, 102, 102]
    assert columns.tolist() == [5, 6, 8, 9, 7, 8, 9, 7] and values.tolist() == [1, 2, 1, 2, 3, 4, 5, 6]
    assert [part.size for part in smooth_entries([], 100)] == [0, 0, 0]


# --- separable programs -----------------------------------------------------------------------------------


def separable() -> tuple[SeparableProgram, Any, list[Any]]:
    """Three rows of four variables and one constant: F(z, d) = (z0 z1 d, sin z0) at three points, once z0 = z1."""
    z, d = ca.SX.sym("z", 2), ca.SX.sym("d")
    function = PointFunction.build("f", z, d, ca.vertcat(z[0] * z[1] * d, ca.sin(z[0])))
    places = np.array([[0, 2, 3], [1, 2, 4]])
    weights = scipy.sparse.csc_array(
        np.array([[1.0, 2, 0, 3, 4, 0], [0, 5.0, 6, 0, 0, 0], [0, 0, 0, 0, 7.0, 8]])
    )
    data = ca.MX(ca.DM([[10.0, 20.0, 30.0]]))
    linear = scipy.sparse.coo_array(([1.0, -2.0, 0.5], ([0, 2, 2], [3, 0, 0])), shape=(3, 4))
    program = SeparableProgram(linear, (PointBlock(function, places, data, weights),))

    x, c = ca.SX.sym("x", 4), ca.SX.sym("c", 1)
    full = ca.vertcat(x, c)
    outputs = [
        v
        for j, k in enumerate((10.0, 20.0, 30.0))
        for v in (full[int(places[0, j])] * full[int(places[1, j])] * k, ca.sin(full[int(places[0, j])]))
    ]
    rows = ca.DM(linear.toarray()) @ x + ca.DM(weights.toarray()) @ ca.vertcat(*outputs)
    return program, rows, [x, c]


def test_a_separable_program_has_the_derivatives_of_its_sum() -> None:
    program, rows, (sx, sc) = separable()
    x, c, lam = ca.MX.sym("x", 4), ca.MX.sym("c"), ca.MX.sym("lam", 3)
    values, entries = program.values_and_jacobian(x, c)
    found = ca.Function("f", [x, c, lam], [values, entries, program.hessian(x, c, lam), program.values(x, c)])
    at, constant, multipliers = [0.3, -0.7, 1.1, 0.4], 2.5, [1.0, -2.0, 0.5]
    v, j, h, again = (np.array(o).ravel() for o in found(at, constant, multipliers))
    exact = ca.Function("e", [sx, sc], [rows, ca.jacobian(rows, sx)])(at, constant)
    assert v == pytest.approx(np.array(exact[0]).ravel()) and again == pytest.approx(v)
    dense = np.zeros((3, 4))
    dense[program.jacobian_pattern] = j
    assert dense == pytest.approx(np.array(exact[1]))
    curved = ca.hessian(ca.dot(ca.DM(multipliers), rows), sx)[0]
    upper = np.zeros((4, 4))
    upper[program.hessian_pattern] = h
    assert upper == pytest.approx(np.triu(np.array(ca.Function("h", [sx, sc], [curved])(at, constant))))
    order = program.jacobian_pattern[0] + 3 * program.jacobian_pattern[1]
    assert np.all(np.diff(order) > 0) and (program.n_rows, program.n_variables) == (3, 4)


def test_some_rows_of_a_separable_program() -> None:
    program, rows, (sx, sc) = separable()
    x, c = ca.MX.sym("x", 4), ca.MX.sym("c")
    at, constant = [0.3, -0.7, 1.1, 0.4], 2.5
    exact = np.array(ca.Function("e", [sx, sc], [rows])(at, constant)).ravel()
    for first, end in ((0, 1), (1, 3), (2, 3)):
        part = program.rows(first, end)
        assert np.array(ca.Function("f", [x, c], [part.values(x, c)])(at, constant)).ravel() == pytest.approx(
            exact[first:end]
        )
    empty = SeparableProgram(
        program.linear,
        (
            PointBlock(
                program.blocks[0].function,
                program.blocks[0].variables,
                program.blocks[0].data,
                program.blocks[0].weights * 0,
            ),
        ),
    )
    assert empty.n_rows == 3
    apart = SeparableProgram(
        program.linear,
        (
            PointBlock(
                program.blocks[0].function,
                program.blocks[0].variables,
                program.blocks[0].data,
                scipy.sparse.csc_array(np.eye(3, 6)),
            ),
        ),
    )
    assert (
        len(apart.rows(0, 1).blocks) == 1
        and program.blocks[0].points == 3
        and program.blocks[0].function.rows == 2
    )
    none = SeparableProgram(
        program.linear,
        (
            PointBlock(
                program.blocks[0].function,
                program.blocks[0].variables,
                program.blocks[0].data,
                scipy.sparse.csc_array((3, 6)),
            ),
        ),
    )
    assert none.rows(0, 3).blocks == ()


# --- nonlinear programs -----------------------------------------------------------------------------------


def nlp(**derivatives: Any) -> NlpProblem:
    x, p = ca.MX.sym("x", 2), ca.MX.sym("p")
    return NlpProblem(
        x, p, p * x[0] ** 2 + x[1], ca.vertcat(x[0] * x[1], x[0] - x[1], x[1] ** 2), **derivatives
    )


def with_derivatives() -> NlpProblem:
    base = nlp()
    x, p, lam_f, lam_g = base.x, base.p, ca.MX.sym("lf"), ca.MX.sym("lg", 3)
    lagrangian = lam_f * base.f + ca.dot(lam_g, base.g)
    return nlp(
        grad_f=ca.Function("a", [x, p], [base.f, ca.densify(ca.gradient(base.f, x))]),
        jac_g=ca.Function("b", [x, p], [base.g, ca.jacobian(base.g, x)]),
        hess_lag=ca.Function("c", [x, p, lam_f, lam_g], [ca.triu(ca.hessian(lagrangian, x)[0])]),
    )


def test_a_program_counts_and_differentiates() -> None:
    given, plain = with_derivatives(), nlp()
    assert (plain.n_variables, plain.n_constraints, plain.n_parameters) == (2, 3, 1)
    for program in (given, plain):
        f, g, gradient = (
            np.array(v).ravel() for v in program.lagrangian([2.0, 3.0], 5.0, [1.0, 10.0, 100.0])
        )
        assert f.tolist() == [23.0] and g.tolist() == [6, -1, 9]
        assert gradient.tolist() == [20 + 3 + 10, 1 + 2 - 10 + 600]
    assert joint_jacobian(plain) is None and full_hessian(plain) is None
    f, slope, g, jacobian = (np.array(v) for v in joint_jacobian(given)([2.0, 3.0], 5.0))
    assert (
        f.item() == 23.0
        and slope.ravel().tolist() == [20, 1]
        and jacobian.tolist() == [[3, 2], [1, -1], [0, 6]]
    )
    assert np.array(full_hessian(given)([2.0, 3.0], 5.0, 1.0, [1.0, 10.0, 100.0])).tolist() == [
        [10, 1],
        [1, 200],
    ]
    x, p = plain.x, plain.p
    half = nlp(
        grad_f=ca.Function(
            "a", [x, p], [p * x[0] ** 2 + x[1], ca.densify(ca.gradient(p * x[0] ** 2 + x[1], x))]
        )
    )
    assert joint_jacobian(half) is None and np.array(
        half.lagrangian([2.0, 3.0], 5.0, [0, 0, 0])[2]
    ).ravel().tolist() == [20, 1]


# --- the program of a problem -----------------------------------------------------------------------------


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
    part, found = program.parts["leg"].collocation, program.variable_interval(problem)
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
    assert found.lower[program.parameter_places].tolist() == [0.5] and found.upper[
        program.parameter_places
    ].tolist() == [2.0]
    rows = program.row_interval(problem)
    dynamics = np.concatenate([r.ravel() for r in part.dynamics_rows])
    assert not rows.lower[dynamics].any() and not rows.upper[dynamics].any()
    assert set(rows.upper[part.path_rows[0]]) == {100.0} and set(rows.lower[part.path_rows[1]]) == {-50.0}
    ends = program.end_rows
    assert list(ends) == [
        "duration of phase leg",
        "length of arc 1, phase leg",
        "length of arc 2, phase leg",
        "constraint sum",
    ]
    assert [rows.lower[i] for i in ends.values()] == [0.25, 1e-9, 1e-9, -np.inf]
    assert [rows.upper[i] for i in ends.values()] == [5.0, np.inf, np.inf, 7.0]
    assert (
        program.constraint_rows.tolist() == [ends["constraint sum"]]
        and len(program.row_labels) == program.n_constraints
    )
    assert program.row_labels[-1] == "constraint sum" and len(program.variable_labels) == program.n_variables
    assert program.variable_labels[-4:] == (
        "initial time, phase leg",
        "boundary 1 time, phase leg",
        "final time, phase leg",
        "parameter tight",
    )
    lam = np.arange(float(program.n_constraints))
    assert program.duration_multiplier("leg", lam) == ends["duration of phase leg"]
    assert program.fixed_times(problem).tolist() == [0.0, 0.0]


def test_the_program_without_free_times() -> None:
    problem = cart()
    program = Transcription(problem, {"leg": Mesh.uniform(2, 3)}, "LG")
    assert program.parts["leg"].times.tolist() == [program.n_variables, program.n_variables + 1]
    assert program.fixed_times(problem).tolist() == [0.0, 1.0] and program.end_rows == {}
    assert program.duration_multiplier("leg", np.ones(program.n_constraints)) == 0.0
    assert program.numbers(problem).tolist() == [1.0, 0.0, 1.0]
    vector = program.parameter_vector(
        problem, np.full(program.n_variables, 2.0), np.full(program.n_constraints, 3.0), 4.0
    )
    assert (
        vector.size == 3 + program.n_variables + program.n_constraints + 1
        and vector[-1] == 4.0
        and vector[3] == 2.0
    )


def test_a_bound_that_rounding_crosses_is_met() -> None:
    problem = cart()
    leg = problem.get_phase()
    leg.bounds(q=(-3.0, 4.0))
    leg.final(q=4.0 + 1e-15)
    program = Transcription(problem, {"leg": Mesh.uniform(1, 2)}, "LG")
    found = program.variable_interval(problem)
    assert np.all(found.lower <= found.upper)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_scaled_program_and_its_derivatives(scheme: Scheme) -> None:
    """Gradient, Jacobian and Hessian of the scaled program, by central differences of its own values."""
    problem = problem_of_all()
    program = Transcription(problem, {"leg": Mesh((0.0, 0.5, 1.0), (2, 3), (1,))}, scheme)
    rng = np.random.default_rng(0)
    n, m = program.n_variables, program.n_constraints
    scales, rows = rng.uniform(0.5, 2, n), rng.uniform(0.5, 2, m)
    p = program.parameter_vector(problem, scales, rows, 3.0)
    x = rng.uniform(0.5, 1.5, n)
    x[program.parts["leg"].times] = np.array([0.5, 2.0, 4.0]) / scales[program.parts["leg"].times]
    f = ca.Function("f", [program.nlp.x, program.nlp.p], [program.nlp.f, program.nlp.g])
    h = 1e-6
    columns = [
        [np.array(v).ravel() for v in f(x + s * h * np.eye(n)[i], p)] for i in range(n) for s in (1, -1)
    ]
    slope = np.array([(columns[2 * i][0] - columns[2 * i + 1][0])[0] / (2 * h) for i in range(n)])
    jacobian = np.array([(columns[2 * i][1] - columns[2 * i + 1][1]) / (2 * h) for i in range(n)]).T
    assert np.array(program.nlp.grad_f(x, p)[1]).ravel() == pytest.approx(slope, abs=1e-7)
    assert np.array(program.nlp.jac_g(x, p)[1]) == pytest.approx(jacobian, abs=1e-7)
    lam = rng.normal(size=m)
    gradient = program.nlp.lagrangian
    bent = np.array(
        [
            (np.array(gradient(x + h * e, p, lam)[2]) - np.array(gradient(x - h * e, p, lam)[2])).ravel()
            / (2 * h)
            for e in np.eye(n)
        ]
    )
    assert np.array(program.nlp.hess_lag(x, p, 1.0, lam)) == pytest.approx(np.triu(bent), abs=1e-6)
    g, grad, nonzeros = program.evaluate(problem, x * scales)
    assert grad == pytest.approx(slope / scales / 3.0, abs=1e-7) and g * rows == pytest.approx(
        np.array(f(x, p)[1]).ravel()
    )
    assert nonzeros.size == program.constraints.jacobian_pattern[0].size


def test_programs_are_kept_the_last_few_of_them() -> None:
    problem = cart()
    meshes = [{"leg": Mesh.uniform(k, 2)} for k in range(1, CACHED_PROGRAMS + 2)]
    first = transcribe(problem, meshes[0], "LG")
    assert (
        transcribe(problem, meshes[0], "LG") is first and transcribe(problem, meshes[0], "LGR") is not first
    )
    for mesh in meshes[1 : CACHED_PROGRAMS - 1]:
        transcribe(problem, mesh, "LG")
    assert transcribe(problem, meshes[0], "LG") is first
    for mesh in meshes[1:]:
        transcribe(problem, mesh, "LG")
    assert transcribe(problem, meshes[0], "LG") is not first
    free_time = cart()
    one = transcribe(free_time, meshes[0], "LG")
    free_time.get_phase().time(0.0, (0.5, 2.0))
    assert transcribe(free_time, meshes[0], "LG") is not one
    with pytest.raises(UnknownNameError, match="no phase 'lag'"):
        transcribe(problem, {"lag": Mesh.uniform(1, 2), "leg": Mesh.uniform(1, 2)}, "LG")


# --- scales -----------------------------------------------------------------------------------------------


def test_variables_are_scaled_by_what_the_user_says_or_by_what_is_found() -> None:
    problem = problem_of_all().with_scale(v=0.25)
    problem.get_phase().guess(time=(0.5, -6.0 + 12.5), q=(0.0, 3.0))
    program = Transcription(problem, {"leg": Mesh.uniform(2, 2)}, "LG")
    start = np.zeros(program.n_variables)
    start[program.parameter_places] = 1.5
    found, usual = (scale_variables(program, problem, start, overridden=o) for o in (True, False))
    part = program.parts["leg"].collocation
    assert found[part.boundary_states].tolist() == [[4.0] * 3, [0.25] * 3] and set(
        found[part.point_states][1]
    ) == {0.25}
    assert set(found[part.point_controls].ravel()) == {8.0} and found[program.parameter_places].tolist() == [
        2.0
    ]
    assert found[program.parts["leg"].times] == pytest.approx([6.5, 6.5])
    assert usual[part.boundary_states[1, 0]] != 0.25 and np.array_equal(
        np.delete(usual, np.r_[part.boundary_states[1], part.point_states[1]]),
        np.delete(found, np.r_[part.boundary_states[1], part.point_states[1]]),
    )


def test_rows_are_scaled_by_their_states_or_by_their_slopes() -> None:
    """By what the derivatives are at the guess and near it; scales of the user do not move the place that is near.

    q >= -50 is far away: by a tenth of the distance, at the guess or at q (1 + NEARBY c), c the cosine of its place.
    """
    problem = problem_of_all()
    problem.get_phase().guess(time=(0.5, 6.5), q=(0.0, 3.0), a=(2.0, 2.0))
    program = Transcription(problem, {"leg": Mesh.uniform(2, 2)}, "LG")
    start = np.linspace(0.5, 1.5, program.n_variables)
    scales = scale_variables(program, problem, start)
    rows, objective = scale_rows(program, problem, start, scales)
    part = program.parts["leg"].collocation
    for k in range(2):
        assert rows[part.dynamics_rows[k]] == pytest.approx(
            1 / scales[part.boundary_states[:, [0]]] * np.ones((2, 3))
        )
    mixed, pure = rows[part.path_rows]
    assert mixed == pytest.approx(1 / max(scales[part.point_states[1, 0]], 8.0))
    places = part.point_states[0]
    beside = 1 + NEARBY * np.cos(np.pi * (3 - np.sqrt(5)) * places)
    assert pure == pytest.approx(10.0 / (50.0 + start[places] * np.maximum(1.0, beside)))
    assert objective > 0 and NEARBY == 0.1
    again = scale_rows(program, problem.with_scale(v=1e-3), start, scales)
    assert again[1] == pytest.approx(objective) and again[0] == pytest.approx(rows)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_slopes_are_looked_at_on_one_side_of_the_guess(sense: float) -> None:
    """Of x^3 at the end, guessed at +-2: 12 there, and 12 (1 + NEARBY c)^2 beside it, c the cosine of its place."""
    model = go.Model("integrator")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("cubic")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.guess(x=(2.0 * sense, 2.0 * sense), u=(1.0, 1.0))
    problem.minimize(leg.final_state("x") ** 3)
    program = Transcription(problem, {"leg": Mesh.uniform(1, 3)}, "LG")
    start = np.full(program.n_variables, 2.0 * sense)
    place = int(program.parts["leg"].collocation.boundary_states[0, -1])
    golden = np.pi * (3 - np.sqrt(5))
    near = 2.0 * sense + NEARBY * min(2.0, scale_variables(program, problem, start)[place]) * np.cos(
        golden * place
    )
    steepest = max(12.0, 3 * near**2)
    scales = np.ones(program.n_variables)
    assert scale_rows(program, problem, start, scales)[1] == pytest.approx(1 / steepest)
    assert (steepest > 12.0) == (sense * np.cos(golden * place) > 0)
