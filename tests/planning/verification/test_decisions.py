"""Decisions of the optimality check, from given results of its conditions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from testing.constructed_solutions import fake, interval

import gnc_opt as go
from gnc_opt.array_types import Array
from gnc_opt.planning.problem.active_constraint_arcs import ArcKind
from gnc_opt.planning.solution.defects_and_violations import NO_VIOLATION, Worst
from gnc_opt.planning.verification import active_limits_and_touch_points as limit_terms
from gnc_opt.planning.verification import bang_bang_second_order_conditions as bang_bang
from gnc_opt.planning.verification import external_trajectory_check as external
from gnc_opt.planning.verification import minimum_principle as controls
from gnc_opt.planning.verification import optimality_check as check
from gnc_opt.planning.verification import reduced_hessian, singular_arcs
from gnc_opt.planning.verification.nonsmooth_points import KinkPoint
from gnc_opt.planning.verification.singular_arcs import SingularArc

PASS, FAIL, INCONCLUSIVE = go.ConditionResult.PASS, go.ConditionResult.FAIL, go.ConditionResult.INCONCLUSIVE

GOOD, WEAK, BAD = SingularArc("good", 1, 0.5), SingularArc("weak", 2, 0.25), SingularArc("bad", 1, -0.5)
GOH = SingularArc("goh", 0, -0.75)
UNKNOWN = SingularArc("unknown", 0, 0.0, "why")
FLAT = SingularArc("flat", 1, 1e-7)


@pytest.mark.parametrize(
    ("arcs", "result", "value", "where"),
    [
        ([GOOD], PASS, -0.5, "good: order 1"),
        ([GOOD, WEAK], PASS, -0.25, "weak: order 2"),
        ([BAD, GOOD, UNKNOWN], FAIL, 0.5, "bad: order 1"),
        ([UNKNOWN, GOH, BAD], FAIL, 0.75, "goh: Goh's condition"),
        ([GOOD, UNKNOWN], INCONCLUSIVE, 0.0, "unknown: why"),
        ([UNKNOWN, FLAT], INCONCLUSIVE, 0.0, "unknown: why"),
        ([GOOD, FLAT], INCONCLUSIVE, -1e-7, "flat: order 1"),
    ],
)
def test_which_singular_arc_counts(arcs: list[SingularArc], result: Any, value: float, where: str) -> None:
    """One that fails before one of which nothing is told, before the least; whatever their order."""
    for given in (arcs, arcs[::-1]):
        condition = singular_arcs.check_generalised_legendre_clebsch(given, 1e-5)
        assert (condition.result, condition.where, condition.tolerance) == (result, where, -1e-5)
        assert condition.value == pytest.approx(value) and condition.sufficient


def test_what_keeps_a_verdict_open() -> None:
    """Those that fail, then necessary ones that are not told; what only suffices may stay untold."""
    conditions = [
        go.Condition(f"{result.name} {sufficient}", result, 0.0, 0.0, "", "", sufficient)
        for sufficient in (True, False)
        for result in (INCONCLUSIVE, FAIL, PASS)
    ]
    verdict = go.Verdict("name", tuple(conditions))
    assert [c.name for c in verdict.open_conditions] == ["FAIL True", "FAIL False", "INCONCLUSIVE False"]
    assert [c.name for c in verdict.failed] == ["FAIL True", "FAIL False"]
    assert [c.name for c in verdict.inconclusive] == ["INCONCLUSIVE True", "INCONCLUSIVE False"]
    assert go.Verdict("name", tuple(conditions[::3])).open_conditions == (conditions[3],)


def condition(name: str, result: Any = PASS, value: float = 1.0, *, sufficient: bool = False) -> go.Condition:
    return go.Condition(name, result, value, 0.5, "w", "m", sufficient=sufficient)


def verdict(monkeypatch: pytest.MonkeyPatch, **given: Any) -> str:
    """Results (P, F or I) of dynamics, limits, boundary, cost; stationarity, active set, minimum principle, kinks;
    second order and switching times; followed by what was evaluated."""
    state = {
        "costates": True,
        "missing": NO_VIOLATION,
        "least": False,
        "unique": False,
        "concave": None,
        "rough": None,
        "trajectory": (PASS, PASS, PASS, PASS),
        "first": (PASS, PASS, PASS),
        "second": (PASS, PASS),
        "lasting": (True,),
    } | given
    called = ""

    def result(name: str, value: Any, note: str = "") -> Any:
        def answer(*_: Any, **__: Any) -> Any:
            nonlocal called
            called += note
            return value() if callable(value) else value

        monkeypatch.setattr(check, name, answer)

    legs = [fake(phase=fake(name=f"leg {k}"), has_duration=on) for k, on in enumerate(state["lasting"])]
    for s in legs:
        s.with_cost_scale = lambda *_, s=s: s
    problem = fake(phases={})
    solution = fake(samples=lambda: dict(enumerate(legs)), problem_name="p", need_problem=lambda _: problem)
    solution.status = go.Status.OPTIMAL
    result("recompute_stored_data", solution)
    result("get_endpoint_gradients", fake(cost=0.0))
    result("choose_cell_edges_at_narrow_features", None)
    result("list_boundary_table_calls", ())
    ends = fake(compute_endpoint_changes=lambda: np.ones(1))
    monkeypatch.setattr(check.EndPoints, "from_solution", lambda *_: ends)
    monkeypatch.setattr(check.Scales, "from_solution", lambda *_: fake(change_of_cost=1.0))
    result("has_costates", state["costates"])
    result("find_nonfinite_stored_value", state["missing"])
    result("compare_costates", NO_VIOLATION, "i")
    names = ("dynamics", "limits", "boundary conditions", "cost")
    made = [condition(name, value) for name, value in zip(names, state["trajectory"], strict=True)]
    functions = ("dynamics", "trajectory_limits", "boundary_conditions", "reported_cost")
    for function, value in zip(functions, made, strict=True):
        monkeypatch.setattr(check.feasibility, f"check_{function}", lambda *_, v=value: v)
    result("check_stored_data", condition("stored numbers"))
    first = [
        condition(n, v)
        for n, v in zip(("stationarity", "active set", "minimum principle"), state["first"], strict=True)
    ]
    result("_check_first_order_conditions", lambda: list(first))
    result("find_concave_kink", state["concave"], "c")
    result("attains_lower_bound", state["least"], "b")
    second = [
        condition(n, v, sufficient=True) for n, v in zip(check._SECOND_ORDER, state["second"], strict=True)
    ]
    result("_check_second_order_and_switching_times", lambda: list(second), "s")
    result("_check_singular_arcs", list, "a")
    result("_is_solution_unique", state["unique"], "u")
    result("find_nonsmooth_point", state["rough"], "n")
    found = check._check_optimality_conditions(solution, 1e-5)
    letters = "".join(c.result.value[0] for c in found.conditions)
    assert found.not_checked == ("" if state["costates"] else "no costates")
    return f"{letters} {''.join(sorted(called))}"


def test_conditions_that_depend_on_others(monkeypatch: pytest.MonkeyPatch) -> None:
    gap, kink = Worst(np.inf, "gap"), KinkPoint(0.1, "kink", True)
    for given, expected in (
        ({}, "PPPPPPPPPP bcins"),
        ({"second": (INCONCLUSIVE, FAIL)}, "PPPPPPPPIF bcinsu"),
        ({"second": (INCONCLUSIVE, PASS), "unique": True}, "PPPPPPPPPP bcinsu"),
        ({"second": (INCONCLUSIVE, PASS), "unique": False}, "PPPPPPPPIP bcinsu"),
        ({"trajectory": (FAIL, PASS, PASS, PASS), "unique": True}, "FPPPPPPPII abcin"),
        ({"trajectory": (PASS, PASS, PASS, FAIL)}, "PPPFPPPPPP bcins"),
        ({"first": (PASS, FAIL, PASS)}, "PPPPPFPPII abcin"),
        ({"first": (FAIL, PASS, PASS), "least": True}, "PPPPPPPPPP bcins"),
        ({"second": (FAIL, PASS), "least": True}, "PPPPPPPPIP bcinsu"),
        ({"concave": kink, "rough": kink}, "PPPPPPPFII abci"),
        ({"rough": kink}, "PPPPPPPIPP bcins"),
        ({"rough": kink, "second": (FAIL, PASS)}, "PPPPPPPIIP bcins"),
        ({"missing": gap}, "PPPPIIIPII biu"),
        ({"missing": gap, "first": (FAIL, PASS, PASS)}, "PPPPFIIPII abi"),
        ({"costates": False}, "PPPPIIIPII n"),
        ({"costates": False, "first": (FAIL, PASS, PASS), "least": True}, "PPPPIIIPII n"),
        ({"lasting": (True, False)}, "PPPPIIIPII bcinsu"),
        ({"lasting": (True, False), "second": (FAIL, PASS)}, "PPPPIIIPFI bcinsu"),
    ):
        assert verdict(monkeypatch, **given) == expected, given


def curvature(value: float, share: float = 1.0, gain: float = 1.0, sign: float = 1.0) -> Any:
    return reduced_hessian.Curvature(value, np.copysign(share, value), np.array([sign]), gain)


def test_curvature_with_and_without_weakly_active_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reduced_hessian, "_has_partly_singular_segment", lambda s: s == "partly")
    monkeypatch.setattr(reduced_hessian, "_find_bang_bang_control", lambda samples: "jumps")
    monkeypatch.setattr(reduced_hessian, "_describe_largest_variation_component", lambda *_: "place")

    def found(
        free: Any, bound: Any = None, end: Any = ("", np.inf), s: str = "s", **given: Any
    ) -> tuple[Any, ...]:
        weak = np.array([False, bound is not None])
        cone = fake(point=None, unit=None, extra_rows=None, strong=np.array([True, False]), weak=weak)
        cone.is_direction_in_cone = lambda direction, samples: direction[0] in given.get("admitted", (1.0,))
        cone.is_curvature_multiplier_dependent = lambda direction: given.get("several", False)
        monkeypatch.setattr(reduced_hessian, "find_cost_reducing_final_pulse", lambda cone, s: end)
        monkeypatch.setattr(
            reduced_hessian, "minimise_curvature", lambda p, held, *_: bound if np.all(held) else free
        )
        one = reduced_hessian.check_reduced_hessian(fake(structure=given.get("structure", (1,))), [s], cone)
        assert one.tolerance == (0.0 if "no degree" in one.where else -1e-6) or given or end[0]
        return one.result, one.value, one.where

    assert found(curvature(0.5)) == (PASS, -0.5, "place")
    assert found(curvature(0.5), structure=()) == (INCONCLUSIVE, -0.5, "jumps")
    assert found(curvature(0.5), end=("end", 0.0)) == (INCONCLUSIVE, -0.5, "end")
    assert found(curvature(0.5), end=("end", -1.1e-4)) == (FAIL, 1.1e-4, "end")
    assert found(curvature(0.5), end=("end", -0.9e-4))[0] is INCONCLUSIVE
    result, value, where = found(curvature(np.nan))
    assert (result, value) == (PASS, 0.0) and where.startswith("no degree of freedom")
    assert found(curvature(-0.5))[:2] == (FAIL, 0.5) and "lowers the cost by 1" in found(curvature(-0.5))[2]
    assert found(curvature(-0.5), admitted=(-1.0,))[0] is FAIL
    several = found(curvature(-0.5), several=True)
    assert several == (INCONCLUSIVE, 0.5, "place: the multipliers are not unique")
    text = "place: the curvature is negative, but limits may exclude this variation"
    assert found(curvature(-0.5), admitted=())[2] == text
    assert found(curvature(-0.5), curvature(-0.25, sign=2.0), admitted=(2.0,))[:2] == (FAIL, 0.25)
    assert found(curvature(-0.5), curvature(0.25, sign=2.0), admitted=(2.0,))[:2] == (INCONCLUSIVE, 0.5)
    assert found(curvature(-0.9e-4))[0] is INCONCLUSIVE
    assert "cannot be distinguished" in found(curvature(-0.9e-4))[2]
    assert found(curvature(-5e-3), s="partly")[0] is INCONCLUSIVE
    assert found(curvature(-2e-2), s="partly")[0] is FAIL
    assert found(curvature(5e-7))[0] is INCONCLUSIVE and found(curvature(2e-6))[0] is PASS
    assert found(reduced_hessian.Curvature(-0.5, -1.0, np.array([1.0]), 1.0, 0.9))[0] is FAIL
    noise = reduced_hessian.Curvature(-0.5, -1.0, np.array([1.0]), 1.0, 1.1)
    assert found(noise)[2].endswith("lowers the cost by 1, which is within rounding")
    assert curvature(2e-6).is_positive
    assert not curvature(5e-7).is_positive
    assert not curvature(0.5, 5e-7).is_positive
    assert not curvature(-0.5, 5e-7).is_negative(0.1) and not curvature(-0.5).is_negative(0.6)


def test_the_trajectory_of_another_tool_is_checked_until_its_multipliers_fit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Solutions are labelled by their numbers of parts and distances from limits; each has given failures."""

    def run(
        failures: dict[str, Any], growth: float = 9.0, n: int = 40, sufficient: str = "active set"
    ) -> Any:
        seen: list[str] = []

        def build(problem: Any, samples: Any, q: Any, parts: int = 1, distance: float = 0.0) -> str:
            return f"{parts}/{distance:g}/{samples['leg'].t.size}"

        def judge(solution: str, tol: float) -> go.Verdict:
            seen.append(solution)
            names = ("dynamics", "stationarity", "active set")
            size = 1.0 if solution.endswith(f"/{n}") else growth
            failed = failures.get(solution, failures.get("else", ()))
            results = {k: FAIL if k in failed else PASS for k in names}
            found = [condition(k, r, size, sufficient=k == sufficient) for k, r in results.items()]
            return go.Verdict("p", tuple(found))

        monkeypatch.setattr(external, "_build_sampled_solution", build)
        monkeypatch.setattr(external, "verify", judge)
        samples = external.SampledPhase(np.arange(float(n)), np.zeros((1, n)), np.zeros((1, n)))
        problem = fake(phases={"leg": None})
        found = external._check_sampled_trajectory(problem, {"leg": samples}, np.zeros(0), 1e-5)
        assert found.estimated
        return "".join(c.result.value[0] for c in found.conditions), " ".join(seen)

    assert run({}) == ("PPP", "1/0/40")
    near = "1/0/40 1/1e-07/40 1/1e-09/40"
    assert run({}, sufficient="") == ("PPP", near)
    assert run({"1/0/40": ["stationarity"]}) == ("PPP", "1/0/40 1/1e-07/40")
    assert run({"1/0/40": ["active set"], "1/1e-07/40": ["dynamics"]}) == ("PPP", near)
    split = dict.fromkeys([*near.split(), "2/0/40"], ("stationarity",))
    assert run(split) == ("PPP", f"{near} 2/0/40 4/0/40")
    assert run({"else": ["active set"]}, growth=3.0)[0] == "PPF"
    assert run({"else": ["active set"]}) == ("PPI", f"{near} 1/0/21")
    assert run({"else": ["dynamics"]}, growth=3.0)[0] == "IPP" and run({"else": ["dynamics"]}, n=15) == (
        "FPP",
        "1/0/15",
    )
    assert run({"else": ["dynamics"]}, n=16)[0] == "IPP"


def test_arcs_of_controls_at_bounds_between_jumps() -> None:
    """u jumps at 1 and is cut at 2; v is at its lower bound, or between its bounds somewhere."""

    def arcs(v: float = -2.0, movable: tuple[int, ...] = (1,)) -> list[tuple[Any, ...]]:
        t = np.array([0.0, 0.5, 1.5, 2.5, 3.0])
        leg = fake(
            name="leg",
            breaks=np.array([0.0, 1.0, 2.0, 3.0]),
            mesh=fake(arc_breaks=(0, 1, 2, 3), movable=movable),
            point_times=t,
            controls=fake(labels=("u", "v")),
            control_bounds=interval([-1.0, -2.0], [1.0, 2.0]),
            u=lambda times: np.stack([np.where(times < 1, 1.0, -1.0), np.where(times == 1.5, v, -2.0)]),
        )
        return [(a.channel, a.kind, a.start, a.end) for a in external._find_arcs_at_control_bounds(leg)]

    whole = [("u", ArcKind.UPPER, 0.0, 1.0), ("u", ArcKind.LOWER, 1.0, 3.0), ("v", ArcKind.LOWER, 0.0, 3.0)]
    assert arcs() == whole and arcs(-2 + 1.9e-6) == whole
    assert arcs(-2 + 2.1e-6) == [] and arcs(0.0) == [] and arcs(movable=()) == []


def test_least_curvature_of_free_controls_that_lasts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both controls are free at the first samples, with the eigenvalues 1 and 3; then the first alone; then none."""
    bases = [np.eye(2)] * 3 + [np.eye(2)[:, :1]] * 3 + [np.zeros((2, 0))] * 2
    monkeypatch.setattr(controls, "compute_free_control_directions", lambda s, mask, unit: bases)
    monkeypatch.setattr(controls, "_mask_interior_controls", lambda s: np.ones((2, 8), dtype=bool))
    monkeypatch.setattr(
        controls,
        "find_lasting_minimum_sample",
        lambda times, values: seen.append(values) or int(np.argmin(values)),
    )
    seen: list[Array] = []
    hessian = np.repeat(np.array([[8.0, 4.0], [4.0, 8.0]])[:, :, None], 8, axis=2)
    hessian[0, 0, 4] = np.nan
    s = fake(
        control_span=np.array([1.0, 1.0]),
        hamiltonian_change_by_control=np.full(2, 4.0),
        control_hessian=hessian,
        times=np.arange(8.0),
        describe_sample=lambda j: f"sample {j}",
    )
    assert controls._find_least_hessian_eigenvalue(s, np.ones((2, 8), dtype=bool)) == (
        -np.inf,
        "sample 4",
    )
    np.testing.assert_allclose(seen[0], [1, 1, 1, 2, -np.inf, 2, np.inf, np.inf])
    bases[:] = bases[6:] * 4
    assert controls._find_least_hessian_eigenvalue(s, np.ones((2, 8), dtype=bool))[1] is None


def test_multipliers_nearest_to_those_of_a_solution() -> None:
    """Of four conditions the second is inactive and the last depends on the fixed unknown; one and three coincide."""
    jacobian = np.array([[3.0, 4.0, 9.0], [1.0, 0.0, 0.0], [6.0, 8.0, 0.0], [0.0, 1e-12, 5.0]])
    at = np.array([True, False, False, True]), np.array([False, False, True, True])
    induced = fake(
        unknowns=fake(free=np.array([True, True, False])),
        conditions=fake(active_limits=at, multipliers=np.array([1.0, 9.0, 0.0, 9.0])),
    )
    gradient = np.array([-9.0, -12.0, 7.0])
    active, rows, norms, found = bang_bang.estimate_nearest_multipliers(gradient, jacobian, induced)
    np.testing.assert_array_equal(active, [0, 2])
    np.testing.assert_allclose(norms, [5.0, 10.0])
    np.testing.assert_allclose(rows, [[0.6, 0.8]] * 2)
    np.testing.assert_allclose(found, [5.0 + 5.0, 5.0])


def test_a_touch_point_moves_with_the_rate_of_its_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """g of order 2 at its limit changes by 1, its rate by 2 or -2, with the curvature -4 after and -8 before."""
    curves = {"after": -4.0, "before": -8.0}

    class Rows:
        row_scales = np.array([1.0, 1.0, 1.0, 1.0])

        def __init__(self, problem: Any, s: Any) -> None:
            self.order = s.order

        def evaluate_constraints(self, t: Array, x: Array, u: Array) -> Array:
            return np.array([[4.0, 4.0, 3.0], [0.0, 0.0, 0.0], *x])

        def is_near_limits(self, values: Array) -> Array:
            return np.array([[[0, 0, 1], [0, 0, 0], [0, 0, 0], [0, 0, 0]], np.zeros((4, 3))]) > 0

        def get_order_of_constraint_contact(self, i: int) -> int:
            return self.order

        def evaluate_time_derivative(self, i: int, order: int, t: Array, x: Array, u: Array) -> Array:
            return (
                np.array([5.0, 1.0, 3.0])
                if order == 1
                else np.full(3, curves["after" if u[0, 0] > 0 else "before"])
            )

    monkeypatch.setattr(limit_terms, "StateConstraints", Rows)
    monkeypatch.setattr(limit_terms, "replace", lambda s, **_: s)
    s = fake(
        order=2,
        phase=fake(applied=lambda t, side: np.array([1.0 if side == "right" else -1.0])),
        state_scale=np.ones(2),
        span=1.0,
    )
    functions = fake(
        path_state_jacobian=lambda t, x, u: np.stack([np.tile([[2.0], [0.0]], (1, 3)), np.zeros((2, 3))])
    )
    x = np.array([[1.25, 1.25, 0.25], [0.25, -0.25, -0.25]])

    def terms(jump: Any) -> Array:
        return limit_terms.compute_touch_point_lagrangian(fake(), s, functions, 1.0, np.array(jump), x)

    # The jump (6, 1) has the multiplier 3 and a rest of 1 in the second state; the reference column is the last one.
    np.testing.assert_allclose(terms([6.0, 1.0]), [3 + 0.5 + 3 * 4 / 8, 3 + 3 * 4 / 16, 0.0])
    np.testing.assert_allclose(terms([-6.0, 0.0]), [-3.0, -3.0, 0.0])  # a maximum has no negative multiplier
    curves["before"] = -5e-4
    np.testing.assert_allclose(terms([6.0, 0.0]), [3.0, 3.0, 0.0])
    s.order = 1
    np.testing.assert_allclose(terms([6.0, 1.0]), [3.5, 3.0, 0.0])
    s.order = 0
    np.testing.assert_allclose(terms([6.0, 1.0]), [6.5, 6.0, 0.0])
