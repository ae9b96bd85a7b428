"""Variations of a known flight, part by part: where they begin, what limits they keep, what they are told to be."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from testing.constructed_solutions import cart, costates, interval, phase, solution

import gnc_opt as go
from gnc_opt.planning import Arc, ArcKind
from gnc_opt.planning.refinement.switching import collocated_flight as c
from gnc_opt.planning.refinement.switching import warm_start as v

KNOWN = solution(cart(), phase(cart(), integrals=np.array([12.0])))


def begun_at(first: Any, last: float = 1.0) -> go.Problem:
    problem = cart()
    problem.get_phase().time(first, last)
    return problem


def test_a_flight_whose_structure_is_not_known_is_no_guide() -> None:
    arcs = (Arc("leg", "a", ArcKind.UPPER, 0.0, 1.0),)
    known = v.KnownFlight.of(replace(KNOWN, structure=arcs))
    assert known is not None and known.solution.structure == () and known.solution.phases == KNOWN.phases
    assert known.state_scale == pytest.approx(next(iter(KNOWN.samples().values())).state_scale)
    assert v.KnownFlight.of(KNOWN) is None
    two = {"leg": KNOWN.phase(), "other": replace(KNOWN.phase(), name="other")}
    assert v.KnownFlight.of(replace(KNOWN, structure=arcs, phases=two)) is None


@dataclass(frozen=True)
class Step:
    steps: int


@pytest.mark.parametrize(
    ("answers", "steps"),
    [((1, 1), v.FLOW_INITIAL_STEPS // 2), ((1, 0), v.FLOW_INITIAL_STEPS), ((0, 0), None)],
)
def test_variations_are_flown_on_half_the_grid_if_that_leaves_something_to_spare(
    monkeypatch: pytest.MonkeyPatch, answers: Any, steps: int | None
) -> None:
    asked: list[Any] = []

    def settle(start: Any, structure: Any, accuracy: float, step: Any = None) -> Any:
        assert structure == ("known" if step is None else "structure 1")  # what a step is of
        asked.append((accuracy, step))
        flight = SimpleNamespace(step=step or Step(v.FLOW_INITIAL_STEPS))
        return (f"structure {len(asked)}", flight) if answers[len(asked) - 1] else None

    monkeypatch.setattr(v, "settle_flow", settle)
    found = v.KnownFlight(KNOWN, "known", np.ones(2)).differentiated()  # type: ignore[arg-type]
    tries = [(v.ACCURACY, None), (v.FLOW_GRID_ACCURACY_SHARE * v.ACCURACY, Step(v.FLOW_INITIAL_STEPS // 2))]
    assert asked == tries[: 1 + answers[0]] and v.FLOW_GRID_ACCURACY_SHARE < 1
    assert (found and found.step) == (steps and Step(steps))
    if found:
        assert found.structure == f"structure {sum(answers)}"


@pytest.mark.parametrize("first", [0.0, 1.0, -1.0, 1.5, (0.2, 0.3)])
def test_what_does_not_begin_on_the_way_is_known_as_a_whole(first: Any) -> None:
    assert v.on_the_way(KNOWN, begun_at(first, 2.0)) is KNOWN


def test_what_begins_on_the_way_is_the_rest_of_it() -> None:
    left = v.on_the_way(KNOWN, begun_at(0.3))
    t = np.linspace(0.3, 1.0, 5)
    assert (left.phase().initial_time, left.phase().final_time) == (0.3, 1.0)
    assert left.phase().x(t) == pytest.approx(KNOWN.phase().x(t))
    two = replace(KNOWN, phases={"leg": KNOWN.phase(), "other": replace(KNOWN.phase(), name="other")})
    assert v.on_the_way(two, begun_at(0.3)) is two


def test_it_starts_where_its_problem_says() -> None:
    """The whole trajectory moves there, but in what is not given."""
    t = np.linspace(0.0, 1.0, 5)
    box = interval([0.25, -np.inf], [0.25, np.inf])
    moved = v._begun(replace(KNOWN, phases={"leg": replace(KNOWN.phase(), initial_bounds=box)}))
    assert moved is not None
    assert moved.phase().x(t) == pytest.approx(KNOWN.phase().x(t) + np.array([[0.25], [0.0]]))
    for end in ("initial_time", "final_time"):
        other = interval(getattr(KNOWN.phase(), end) + 0.1, getattr(KNOWN.phase(), end) + 0.1)
        leg = replace(KNOWN.phase(), **{f"{end}_bounds": other})
        assert v._begun(replace(KNOWN, phases={"leg": leg})) is None
        free = replace(KNOWN.phase(), **{f"{end}_bounds": interval(-9.0, 9.0)})
        assert v._begun(replace(KNOWN, phases={"leg": free})) is not None


@pytest.mark.parametrize(("share", "kept"), [(0.5, True), (2.0, False)])
@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize(
    ("what", "values", "scales"),
    [
        ("final_bounds", [1.0, 0.0], [20.0, 3.0]), ("initial_time_bounds", [0.0], [1.0]),
        ("final_time_bounds", [1.0], [1.0]), ("duration_bounds", [1.0], [1.0]),
    ],
)  # fmt: skip
def test_a_limit_of_an_end_may_be_missed_by_a_trifle(
    what: str, values: Any, scales: Any, side: int, share: float, kept: bool
) -> None:
    """A flight ends at rest at 1 m after 1 s; each of its ends is tried alone."""
    for row in range(len(values)):
        limits = np.full((2, len(values)), np.array([[-np.inf], [np.inf]]))
        limits[0 if side > 0 else 1, row] = (
            values[row] + side * share * c.LIMIT_EXCEEDED_TOLERANCE * scales[row]
        )
        leg = replace(KNOWN.phase(), **{what: interval(*limits)})
        assert c.keeps_limits(replace(KNOWN, phases={"leg": leg}), np.array([20.0, 3.0])) is kept


@pytest.mark.parametrize(
    ("what", "lower", "upper", "kept"),
    [
        ("control_bounds", [-6.0], [6.0], True), ("control_bounds", [-6.0], [5.0], False),
        ("control_bounds", [-5.0], [6.0], False), ("state_bounds", [-1, -1], [1, 2], True),
        ("state_bounds", [-1, -1], [1, 1.4], False), ("path_bounds", [-99, -1], [99, 2], True),
        ("path_bounds", [-99, 0.1], [99, 2], False), ("path_bounds", [-99, -1], [5.9, 2], False),
    ],
)  # fmt: skip
def test_a_limit_along_the_way_may_not_be_exceeded(what: str, lower: Any, upper: Any, kept: bool) -> None:
    """v is 3/2 at most, a falls from 6 to -6, v + a from 6."""
    leg = replace(KNOWN.phase(), **{what: interval(lower, upper)})
    assert c.keeps_limits(replace(KNOWN, phases={"leg": leg}), np.ones(2)) is kept


@pytest.mark.parametrize("pull", [0.0, 2.0])
@pytest.mark.parametrize("free", [False, True])
def test_multipliers_are_what_the_ends_and_controls_are_worth(pull: float, free: bool) -> None:
    """J = 7 t_0 + 2 t_f + 5 v_0 + 3 q_f + half the integral of a^2.

    With H = lam_q v + lam_v a + a^2 / 2 the multipliers of given ends are H - 7 and -(H + 2), -lam - (0, 5) and
    lam - (3, 0), and that of the control is -(a + lam_v).
    """
    model = go.Model("cart")
    q, speed, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: speed, speed: a})
    problem = go.Problem("cart")
    leg = problem.phase("leg", model)
    leg.time(0.0, (0.5, 9.0) if free else 1.0)
    ends = 7 * leg.initial_time + 2 * leg.final_time + 5 * leg.initial_state("v") + 3 * leg.final_state("q")
    problem.minimize(ends + 0.5 * leg.integral(a**2))
    lam = lambda t, k: costates(t, k) + np.array([[0.0], [pull]])  # noqa: E731
    times = {"final_time_bounds": interval(0.5, 9.0)} if free else {}
    flown = phase(problem, lam=lam, integrals=np.array([12.0]), integral_weights=np.array([0.5]), **times)
    found = c.completed(solution(problem, flown, objective=99.0))
    told = found.phase()
    first, last = (-6 + pull) * 6 + 18, (6 + pull) * -6 + 18
    assert told.time_multipliers == pytest.approx([first - 7, 0.0 if free else -(last + 2)])
    assert told.state_impulses[:, 0] == pytest.approx([12, 6 - pull - 5])
    assert told.state_impulses[:, -1] == pytest.approx([-12 - 3, 6 + pull])
    assert not np.any(told.state_impulses[:, 1:-1])
    assert told.control_multipliers == pytest.approx(np.full((1, 8), -pull), abs=1e-9)
    assert found.objective == pytest.approx(2 + 3 + 6) and found.history is None
