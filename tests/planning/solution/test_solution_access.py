"""What a solution answers, what is wrong with an iterate, and which tries there are: by hand."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.constructed_solutions import cart, phase, rest, solution
from testing.internals import NlpResult, RefinementIteration, ScaledNlp
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.model import Layout, Variable
from gnc_opt.planning import (
    History,
    Mesh,
    RefinementStatus,
    Solution,
    SolveError,
    SolverOptions,
    Status,
    load,
)
from gnc_opt.planning.direct import fixed_mesh_solve as tries
from gnc_opt.planning.direct.solve_failure_report import format_solve_failure_message
from gnc_opt.planning.problem.problem_check import describe_missing_bounds
from gnc_opt.planning.solution.constraint_violation_diagnosis import Violation, list_iterate_violations
from gnc_opt.planning.solution.refinement_history import Actions
from gnc_opt.planning.study import kkt_sensitivity as again

# --- answers ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def moved() -> Solution:
    problem = cart()
    return solution(problem, phase(problem))


def test_a_phase_is_found_by_name_or_by_being_the_only_one(moved: Solution) -> None:
    leg = moved.phases["leg"]
    assert moved.phase() is leg and moved.phase("leg") is leg and moved.scheme == "LG"
    two = replace(moved, phases={"leg": leg, "b": replace(leg, name="b")})
    assert two.phase("b").name == "b"
    for act, message in (
        (lambda: two.phase(), r"has 2 phases: name one of \['leg', 'b'\]"),
        (lambda: moved.phase("lag"), "did you mean 'leg'"),
        (lambda: moved.phase(3), "no phase"),  # type: ignore[arg-type]
        (lambda: replace(moved, phases={}).phase(), "has 0 phases"),
    ):
        with pytest.raises(go.ProblemError, match=message):
            act()


def test_signals_of_a_solution(moved: Solution) -> None:
    assert moved.state("q")(0.5) == pytest.approx(0.5) and moved.control("a", "leg")(0.0) == pytest.approx(
        6.0
    )
    assert moved.costate("q")(0.3) == pytest.approx(-12.0) and moved.saturated_control("a")(
        1.0
    ) == pytest.approx(-6.0)


def test_functions_along_a_solution_are_numbers_or_vectors(moved: Solution) -> None:
    """H is a^2 / 2 (weight 1) + lam_q v + lam_v a = -18, dH/du = a + lam_v = 0 with weight 1/2 on a^2."""
    right = replace(moved, phases={"leg": replace(moved.phase(), integral_weights=np.array([0.5]))})
    assert isinstance(right.hamiltonian(0.25), float) and right.hamiltonian(0.25) == pytest.approx(-18.0)
    assert right.hamiltonian([0.0, 0.5, 1.0]) == pytest.approx([-18.0] * 3)
    slope = right.switching_function("a", 0.25)
    assert isinstance(slope, float) and slope == pytest.approx(0.0, abs=1e-12)
    assert np.shape(right.switching_function("a", [0.1, 0.2])) == (2,)
    assert moved.switching_function("a", 0.25) == pytest.approx(3.0)
    model = moved.need_problem("evaluate").get_phase().model
    value = moved.evaluate(model.symbol("q"), 0.5)
    assert isinstance(value, float) and value == pytest.approx(0.5)
    assert moved.evaluate(model.symbol("q") * 2, [0.0, 0.5]) == pytest.approx([0.0, 1.0])
    both = ca.vertcat(ca.SX(model.symbol("q")), ca.SX(model.symbol("v")))
    assert moved.evaluate(both, [0.0, 0.5, 1.0]) == pytest.approx(
        rest(np.array([0.0, 0.5, 1.0]), 0), abs=1e-12
    )
    assert np.shape(moved.evaluate(both, 0.5)) == (2,)


def test_at_a_boundary_between_segments_the_right_hand_side_is_meant() -> None:
    """q = 1, v = 2, a = 3, lam = (4, 5) before 1/2 s, ten times that after it: H = a^2 + lam_q v + lam_v a."""
    problem = cart()

    def jump(*values: float) -> Any:
        return lambda t, k: [value * (1 + 9 * k) + 0 * t for value in values]

    found = solution(problem, phase(problem, jump(1, 2), jump(3), jump(4, 5)))
    model = found.need_problem("evaluate").get_phase().model
    for sides, factor in ((("left",), 1.0), (("right",), 10.0), ((), 10.0)):
        side: dict[str, Any] = dict.fromkeys(("side",) if sides else (), sides[0] if sides else None)
        assert found.hamiltonian(0.5, **side) == pytest.approx(factor**2 * (9 + 8 + 15))
        assert found.switching_function("a", 0.5, **side) == pytest.approx(factor * (6 + 5))
        assert found.evaluate(model.symbol("q"), 0.5, **side) == pytest.approx(factor)
        for signal, value in ((found.state("v"), 2), (found.control("a"), 3), (found.costate("v"), 5)):
            assert signal(0.5, *sides) == pytest.approx(factor * value)


def test_vector_controls_have_a_switching_function_each() -> None:
    model, _r, u = dynamics("plane", "r:2", "u:2", lambda r, u: {r: u})
    problem, leg = one_phase("plane", model, 0.0, 1.0)
    problem.minimize(leg.integral(u[0] ** 2 + 3 * u[1]))
    found = solution(
        problem, phase(problem, lambda t, k: [t, t], lambda t, k: [2 * t, t], lambda t, k: [5 + 0 * t, 7 + t])
    )
    assert found.switching_function("u", 0.5) == pytest.approx([2 * 1.0 + 5, 3 + 7.5])
    assert np.shape(found.switching_function("u", [0.5])) == (2, 1)


def test_parameters_and_multipliers_by_name(moved: Solution) -> None:
    free = replace(
        moved,
        free_parameters=Layout("parameter", (Variable("p"), Variable("q", 2))),
        parameter_values=np.array([1.0, 2.0, 3.0]),
        constraint_labels=("c", "d[0]", "d[1]"),
        constraint_multipliers=np.array([4.0, 5.0, 6.0]),
    )
    assert free.parameter("p") == 1.0 and isinstance(free.parameter("p"), float)
    assert list(free.parameter("q")) == [2.0, 3.0]  # type: ignore[arg-type]
    assert free.multiplier("c") == 4.0 and isinstance(free.multiplier("c"), float)
    assert list(free.multiplier("d")) == [5.0, 6.0]  # type: ignore[arg-type]
    for act in (lambda: free.parameter("r"), lambda: free.multiplier("e"), lambda: free.multiplier("d[0]")):
        with pytest.raises(go.UnknownNameError):
            act()


def test_accuracy_travels_with_a_file_and_is_measured_with_the_problem(
    moved: Solution, tmp_path: Any
) -> None:
    path = moved.save(tmp_path / "s")
    alone = load(path)
    assert alone.problem is None and alone.accuracy == moved.accuracy and not alone.converged
    again = load(alone.save(tmp_path / "t"))
    assert again.accuracy == moved.accuracy and again.provenance == moved.provenance
    bare = load(replace(moved, problem=None).save(tmp_path / "u"))
    for act in (lambda: bare.accuracy, lambda: bare.hamiltonian(0.5), lambda: bare.propagate()):
        with pytest.raises(go.GncOptError, match="without its problem"):
            act()
    joined = load(path, moved.need_problem("x"))
    assert joined.problem is not None and joined.propagate().error == pytest.approx(0.0, abs=1e-9)
    other = cart()
    other.get_phase().time(0.0, 2.0)
    with pytest.raises(go.ProblemError, match="is not the one"):
        alone.with_problem(other)
    with pytest.raises(go.GncOptError, match=r"cannot refine the solution of 'cart' without its problem"):
        alone.need_problem("refine")


def test_a_solution_is_shown_without_its_problem(moved: Solution) -> None:
    assert "Problem(" not in repr(moved) and "cart" in repr(moved)


def one_pass(segments: int, seconds: float) -> RefinementIteration:
    meshes = {"a": Mesh.uniform(segments, 3), "b": Mesh.uniform(2, 5)}
    return RefinementIteration(meshes, {}, 1e-3, "somewhere", 2.5, True, 7, seconds, Actions(raised=1))


@pytest.mark.parametrize("history", [None, "stalled", "converged"])
def test_a_solution_has_converged_if_its_refinement_has(moved: Solution, history: str | None) -> None:
    passed = None if history is None else History(RefinementStatus(history), 1e-6, (one_pass(3, 1.0),), 0, "")
    assert replace(moved, history=passed).converged is (history == "converged")


def attempt() -> tuple[ScaledNlp, NlpResult]:
    """A cart's program and an iterate that meets everything."""
    problem = cart()
    problem.get_phase().bounds(a=(-8.0, 8.0))
    tried = ScaledNlp.from_problem(problem, {"leg": Mesh.uniform(1, 3)}, "LG", None, SolverOptions())
    point = tried.build_scaled_nlp_point(tried.start)
    return tried, tried.solver.solve(point)


def broken(
    status: Status, x: dict[int, float] | None = None, g: dict[int, float] | None = None
) -> tuple[Violation, ...]:
    tried, result = attempt()
    values, rows = result.x.copy(), result.g.copy()
    for place, value in (x or {}).items():
        values[place] = value
    for place, value in (g or {}).items():
        rows[place] = value
    failed = replace(result, status=status, x=values, g=rows)
    phases = {"leg": phase(tried.problem)}
    return list_iterate_violations(
        tried.transcription, tried.problem, failed, tried.scaling, phases, np.zeros(0)
    )


def test_a_solution_has_no_violations() -> None:
    assert broken(Status.OPTIMAL, g={0: 9.0}) == () == broken(Status.ACCEPTABLE, g={0: 9.0})
    assert broken(Status.INFEASIBLE) == ()


def test_violations_are_named_in_shares_of_their_scales_worst_first() -> None:
    found = broken(Status.INFEASIBLE, x={4: 50.0}, g={0: -0.25, 3: 0.5, 5: math.nan})
    tried, _ = attempt()
    rows, names = tried.transcription.constraint_row_labels, tried.transcription.variable_labels
    above = 50.0 - 8.0 / tried.scaling.variables[4]
    assert names[4].startswith("a, ") and [v.name for v in found] == [
        rows[5],
        f"bound of {names[4]}",
        rows[3],
        rows[0],
    ]
    assert math.isnan(found[0].amount) and [v.amount for v in found[1:]] == pytest.approx([above, 0.5, 0.25])
    below = broken(Status.INFEASIBLE, x={4: -50.0})
    assert below[0].amount == pytest.approx(above)
    assert broken(Status.INFEASIBLE, g={0: 1e-10}) == () and len(broken(Status.INFEASIBLE, g={0: 2e-9})) == 1
    controls = {i: 99.0 for i, name in enumerate(names) if name.startswith("a,")}
    assert len(controls) == 3 and len(broken(Status.INFEASIBLE, controls, dict.fromkeys(range(8), 1.0))) == 10


def test_an_unbounded_problem_names_what_runs_off_once_each() -> None:
    tried, _ = attempt()
    names = tried.transcription.variable_labels
    q = [i for i, name in enumerate(names) if name.startswith("q,")]
    v = [i for i, name in enumerate(names) if name.startswith("v,")]
    found = broken(Status.UNBOUNDED, x={q[1]: 2e6, q[2]: -5e6, v[1]: 3e6, v[2]: 0.9e6})
    assert [f.name for f in found[:2]] == [f"{names[q[2]]} diverges", f"{names[v[1]]} diverges"]
    assert [f.amount for f in found[:2]] == [5e6, 3e6]
    assert not any("diverges" in f.name for f in broken(Status.INFEASIBLE, x={q[1]: 2e6}))
    rows = dict.fromkeys(range(8), 1.0)
    controls = {i: 99.0 for i, name in enumerate(names) if name.startswith("a,")}
    assert len(broken(Status.UNBOUNDED, {q[1]: 2e6, v[1]: 3e6, **controls}, rows)) == 10  # in all
    assert not any("diverges" in f.name for f in broken(Status.UNBOUNDED, x={q[1]: 1e6}))


def test_what_is_not_finite_is_named_with_its_time() -> None:
    model, _x, u = dynamics("root", "x", "u", lambda x, u: {x: u + ca.sqrt(x)})
    problem, leg = one_phase("root", model, 0.0, 1.0)
    leg.guess(x=(1.0, 1.0))
    problem.minimize(leg.integral(u**2))
    tried = ScaledNlp.from_problem(problem, {"leg": Mesh.uniform(1, 3)}, "LG", None, SolverOptions())
    n = tried.transcription.n_constraints
    result = NlpResult(
        tried.start,
        0.0,
        np.zeros(n),
        np.zeros(tried.start.size),
        np.zeros(n),
        Status.NOT_A_NUMBER,
        "",
        1,
        0.0,
        0.0,
        0.0,
    )

    def found(sign: float, status: Status) -> tuple[Violation, ...]:
        phases = {
            "leg": phase(problem, lambda t, k: [1 + sign * 2 * t], lambda t, k: 0 * t, lambda t, k: [t])
        }
        failed = replace(result, status=status)
        return list_iterate_violations(
            tried.transcription, problem, failed, tried.scaling, phases, np.zeros(0)
        )

    lost = found(-1.0, Status.NOT_A_NUMBER)
    assert len(lost) == 1 and ", phase leg, t = 0." in lost[0].name and math.isnan(lost[0].amount)
    assert float(lost[0].name.split("t = ")[1].split()[0]) == pytest.approx(0.533, abs=0.05)
    assert found(1.0, Status.NOT_A_NUMBER) == () == found(-1.0, Status.INFEASIBLE)


def test_a_failure_in_words(moved: Solution) -> None:
    failed = replace(moved, status=Status.INFEASIBLE)
    text = format_solve_failure_message(failed)
    cause, *remedies = text.splitlines()
    meaning, _, remedy = Status.INFEASIBLE.remedy.partition(". ")
    assert cause.startswith(
        "no solution of 'cart' after 5 iterations, status infeasible; all constraints hold"
    )
    assert cause.endswith(f". {meaning}.") and remedies[0] == f"* {remedy}"
    assert remedies[1].startswith("* Give a trajectory as the guess")
    assert "phase.guess(time=..." in remedies[1]
    assert "worst: w (0.25 of its scale)" in format_solve_failure_message(
        replace(failed, violations=(Violation("w", 0.25),))
    )
    assert "worst: w. " in format_solve_failure_message(
        replace(failed, violations=(Violation("w", math.nan), Violation("v", 1.0)))
    )
    error = SolveError(text, failed)
    again = pickle.loads(pickle.dumps(SolveError(text, replace(failed, problem=None))))
    assert str(again) == text and again.solution.problem is None and error.solution.problem is not None
    assert error.__reduce__()[1][1].problem is None


def test_starts_for_the_constraints_are_stretched_within_bounds_and_random() -> None:
    """A final time guessed at 2 s, at most 9 s: free, held at 2, 8 and 9 (once), then two random ones."""
    problem = cart()
    leg = problem.get_phase()
    leg.time(0.0, (0.5, 9.0))
    leg.guess(time=(0.0, 2.0))
    leg.bounds(q=(-1.0, 1.0), v=(-1.0, 1.0), a=(-1.0, 1.0))
    tried = ScaledNlp.from_problem(problem, {"leg": Mesh.uniform(1, 3)}, "LG", None, SolverOptions())
    place = int(tried.transcription.parts["leg"].times[-1])
    starts = list(tries.generate_feasibility_initial_points(tried.transcription, problem, tried.start))
    assert [held.tolist() for _, held in starts] == [[], [place], [place], [place], [], []]
    assert [variables[place] for variables, _ in starts[:4]] == pytest.approx([2.0, 2.0, 8.0, 9.0])
    assert np.array_equal(starts[0][0], tried.start)
    rest_of = np.delete(np.arange(tried.start.size), place)
    assert all(np.array_equal(variables[rest_of], tried.start[rest_of]) for variables, _ in starts[:4])
    assert not np.allclose(starts[4][0], starts[5][0])
    fixed = cart()
    fixed.get_phase().bounds(q=(-1.0, 1.0), v=(-1.0, 1.0), a=(-1.0, 1.0))
    still = ScaledNlp.from_problem(fixed, {"leg": Mesh.uniform(1, 3)}, "LG", None, SolverOptions())
    assert [
        held.tolist()
        for _, held in tries.generate_feasibility_initial_points(still.transcription, fixed, still.start)
    ] == [[]] * 3


@pytest.mark.parametrize("status", [Status.OPTIMAL, Status.INFEASIBLE])
def test_a_sharper_solution_is_kept_if_there_is_one(
    moved: Solution, monkeypatch: pytest.MonkeyPatch, status: Status
) -> None:
    sharp = replace(moved, status=status)
    seen: dict[str, Any] = {}
    monkeypatch.setattr(again, "solve_problem_on_mesh", lambda problem, **more: seen.update(more) or sharp)
    assert again.solve_with_tighter_tolerance(moved) is (sharp if status is Status.OPTIMAL else moved)
    assert seen["options"].tolerance == again.SENSITIVITY_SOLVE_TOLERANCE
    assert seen["guess"] is moved and seen["scheme"] == "LG"


def test_the_mesh_of_a_solve_is_that_of_its_guess_unless_one_is_given(
    moved: Solution, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken: list[Any] = []
    monkeypatch.setattr(
        tries._FixedMeshSolve,
        "solve_with_retries",
        lambda task, guess=None, **_: taken.append((task, guess)) or moved,
    )
    problem = moved.need_problem("x")
    tries.solve_problem_on_mesh(problem, guess=moved)
    tries.solve_problem_on_mesh(problem, "3x2", guess=moved)
    tries.solve_problem_on_mesh(problem)
    tries.solve_problem_on_mesh(problem, guess=replace(moved, phases={}))
    assert [str(task.meshes["leg"]) for task, _ in taken] == ["2x4", "3x2", "20x4", "20x4"]
    assert [guess is not None for _, guess in taken] == [True, True, False, True]
    assert taken[0][0].scheme == "LG" and taken[0][0].options == SolverOptions()


def test_missing_bounds_in_least_time_are_named() -> None:
    """Of a bound on each side, a path limit, an integral, a heading, or another cost, none must be told."""

    def least_time() -> tuple[go.Problem, go.Phase]:
        model = go.Model("cart")
        q, v, w = model.state("q"), model.state("v"), model.state("w")
        a, b, heading = model.control("a"), model.control("b"), model.control("heading")
        model.ode({q: v, v: a + b, w: ca.cos(heading)})
        problem, leg = one_phase("least time", model, 0.0, (0.0, 10.0))
        leg.bounds(b=(-1.0, 1.0))
        problem.minimize(2 * leg.final_time)
        return problem, leg

    problem, leg = least_time()
    assert (
        "neither bounds nor path constraints limit 'a' on both sides: give bounds()"
        in describe_missing_bounds(problem)
    )
    assert "limit 'a' on both sides" in describe_missing_bounds(problem.with_bounds(a=(None, 1.0)))
    assert describe_missing_bounds(problem.with_bounds(a=(-1.0, 1.0))) == ""
    leg.path("thrust", leg.model.symbol("a") ** 2, upper=1.0)
    assert describe_missing_bounds(problem) == ""
    problem, leg = least_time()
    problem.constrain("effort", leg.integral(leg.model.symbol("a") ** 2), upper=1.0)
    assert describe_missing_bounds(problem) == ""
    problem, leg = least_time()
    problem.cost = leg.final_time + leg.final_state("w")
    assert describe_missing_bounds(problem) == ""


def test_missing_bounds_are_named_where_the_least_time_is_its_own_limit() -> None:
    """The least time is its lower limit, which nothing can beat; the printed lines name the missing bounds."""
    model, *_ = dynamics("cart", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("least time", model, 0.0, (0.01, 10.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    problem.minimize(leg.final_time)
    solution = go.solve(problem, mesh="4x4", tol=1e-3)
    assert solution.objective == pytest.approx(0.01)
    assert "limit 'a' on both sides" in str(solution)


def test_signals_of_vector_controls_and_angles_can_be_sent_to_workers() -> None:
    """A thrust vector and a free heading: the same values after pickling."""
    model = go.Model("boat")
    x, thrust = model.state("x", 2), model.vector_control("thrust", 2)[0]
    heading = model.control("heading")
    model.ode({x: thrust + ca.vertcat(ca.cos(heading), ca.sin(heading))})
    problem = go.Problem("drift")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=[0.0, 0.0])
    leg.norm_bounds(thrust=(0.0, 1.0))
    problem.maximize(leg.final_state("x")[0])
    solution = go.solve(problem, mesh="4x3", tol=None)
    for name in ("thrust", "heading"):
        signal = solution.control(name)
        np.testing.assert_array_equal(pickle.loads(pickle.dumps(signal))(0.3), signal(0.3))
