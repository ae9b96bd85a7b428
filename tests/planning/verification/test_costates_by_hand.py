"""Transversality, impulses, complementarity and the adjoint equation on trajectories given by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from testing import constructed_solutions as by_hand
from testing.given_scales import given_scales

import gnc_opt as go
from gnc_opt.planning.solution.samples import PhaseSamples
from gnc_opt.planning.verification.costate_conditions import (
    _impulses,
    _time_transversality,
    adjoint,
    complementarity,
    parameters,
    transversality,
)
from gnc_opt.planning.verification.recomputed import ends_of
from gnc_opt.tolerances import AT_LIMIT

Array = NDArray[np.float64]
FREE = by_hand.interval(-np.inf, np.inf)


def drifting(paths: bool = False) -> go.Problem:
    """x' = (1, u), and perhaps c = x_0 + 3 u and d = x_1."""
    model = go.Model("drift")
    x, u = model.state("x", 2), model.control("u")
    model.ode({x: ca.vertcat(1, u)})
    problem = go.Problem("drift")
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
    if paths:
        leg.path("mixed", x[0] + 3 * u, upper=100.0)
        leg.path("pure", x[1], upper=100.0)
    problem.minimize(3 * leg.final_state("x")[0] + 4 * leg.initial_state("x")[1] ** 2)
    return problem


def drift(problem: go.Problem, begin: float = 0.0, **changes: Any) -> PhaseSamples:
    """x = (1 + t, 2 - t^2), u = -2 t and costates (3 - t, 1 + 2 t) over 2 s, counted from the start."""
    values = {"breaks": (begin, begin + 0.5, begin + 2.0)} | changes
    lam = values.pop("lam", lambda t, k: np.array([3 - t, 1 + 2 * t]))
    return by_hand.samples(
        problem,
        lambda t, k: np.array([1 + t - begin, 2 - (t - begin) ** 2]),
        lambda t, k: np.array([-2 * (t - begin)]),
        lambda t, k: lam(t - begin, k),
        weights=(),
        **values,
    )


@pytest.mark.parametrize(("end", "off"), [("initial", 0.9), ("final", 0.9), ("initial", 1.1), ("final", 1.1)])
def test_a_free_time_is_at_its_limit_in_shares_of_the_range_of_its_limits(end: str, off: float) -> None:
    """Between -998 s - d and 1000 s, or -1000 s and -998 s + d: a time is within a millionth of 2000 s of its limit."""
    slack, begin = off * AT_LIMIT * 2000.0, -1000.0
    limits = (begin - slack, 1000.0) if end == "initial" else (-3000.0, begin + 2.0 + slack)
    changes: dict[str, Any] = {f"{end}_time_bounds": by_hand.interval(*limits)}
    # Of H = lam_0 + lam_1 u the initial value is 3 + 0, which a lower limit of the initial time cannot explain.
    sign = -1.0 if end == "initial" else 1.0
    s = drift(drifting(), begin, **changes, lam=lambda t, k: sign * np.array([3 - t, 1 + 2 * t]))
    ends = ends_of(by_hand.solution(drifting(), s.leg))
    found = _time_transversality(s, ends, np.zeros(2), given_scales([s], cost=4.0))
    level = 3.0 if end == "initial" else abs(1.0 - 5.0 * 4.0)
    if off > 1:
        assert found.value == pytest.approx(level * 2.0 / 4.0, rel=1e-9)  # over the 2 s, of a cost of 4
        assert found.where == f"phase leg, H at its {'start' if end == 'initial' else 'end'}"
    else:
        assert found.value == 0.0


@pytest.mark.parametrize(
    ("end", "row", "bounds", "gap"),
    [
        # lam(0) = -d cost / dx(0) = (0, -16) where free; 3 and 1 are there.
        ("initial", 0, (-9.0, 9.0), 3.0),
        ("initial", 1, (-9.0, 9.0), 17.0),
        ("initial", 0, (1.0, 9.0), 0.0),  # lam(0) > 0 pushes from below
        ("initial", 0, (-9.0, 1.0), 3.0),
        # lam(2) = d cost / dx(2) = (3, 0); 1 and 5 are there.
        ("final", 0, (-9.0, 9.0), -2.0),
        ("final", 1, (-9.0, 9.0), 5.0),
        ("final", 1, (-9.0, -2.0), 0.0),  # the multiplier lam - d cost > 0 pushes from above
        ("final", 1, (-2.0, 9.0), 5.0),
        ("final", 0, (3.0, 9.0), 0.0),
        ("final", 0, (-9.0, 3.0), -2.0),
    ],
)
def test_costates_at_free_ends(end: str, row: int, bounds: tuple[float, float], gap: float) -> None:
    given = {"initial": np.array([1.0, 2.0]), "final": np.array([3.0, -2.0])}[end]
    lower, upper = given.copy(), given.copy()
    lower[row], upper[row] = bounds
    other = "final" if end == "initial" else "initial"
    fixed = {"initial": np.array([1.0, 2.0]), "final": np.array([3.0, -2.0])}[other]
    changes = {
        f"{end}_bounds": by_hand.interval(lower, upper),
        f"{other}_bounds": by_hand.interval(fixed, fixed),
    }
    s = drift(drifting(), **changes)
    scales = given_scales([s], cost=4.0, radius=3.0)
    condition = transversality([s], ends_of(by_hand.solution(drifting(), s.leg)), scales)
    assert condition.value == pytest.approx(abs(gap) * 3.0 / 4.0, rel=1e-9)
    if gap:
        assert condition.where == f"phase leg, {'start' if end == 'initial' else 'end'}, costate of x[{row}]"
        # A limit along the whole phase exerts what one of the end does.
        along = by_hand.interval([-99.0, -99.0], [99.0, 99.0])
        along.lower[row], along.upper[row] = given[row] if gap < 0 else -99.0, given[row] if gap > 0 else 99.0
        if end == "initial":
            along.lower[row], along.upper[row] = given[row], 99.0
        held = PhaseSamples.of(replace(s.leg, state_bounds=along), s.functions)
        ends = ends_of(by_hand.solution(drifting(), held.leg))
        assert transversality([held], ends, scales).value == 0.0


@pytest.mark.parametrize(
    ("impulse", "beside", "left"),
    [
        (-1.5, 2.0, 0.0),
        (-3.0, 2.0, 1.0),
        (1.0, 2.0, 1.0),
        (1.5, -2.0, 0.0),
        (3.0, -2.0, 1.0),
        (-1.0, -2.0, 1.0),
    ],
)
def test_impulses_that_a_push_beside_them_makes_up_for(impulse: float, beside: float, left: float) -> None:
    """200 over half a hundredth of 2 s is 2, of the other sign; the second state is 9 away from its limits."""
    impulses = np.zeros((2, 3))
    impulses[1, 1] = impulse
    s = drift(
        drifting(),
        state_impulses=impulses,
        states=lambda t, k: np.array([0 * t, 100.0 * beside + 0 * t]),
        state_bounds=by_hand.interval([-99.0, 1.75 - 9.0], [99.0, 1.75 + 9.0]),
    )
    found = _impulses(s, given_scales([s], cost=4.0, radius=3.0))
    assert found.value == pytest.approx(left * 3.0 / 4.0, abs=1e-12)
    assert not left or found.where == "phase leg, t = 0.5 s, impulse on x[1]"


def test_impulses_need_the_limit_that_exerts_them() -> None:
    """x_0 is at its upper limit of 1.5 at the break: > 0 is right there, < 0 is off by the room to the lower one."""
    for impulse, room in ((2.0, 0.0), (-2.0, 0.25)):
        impulses = np.zeros((2, 3))
        impulses[0, [0, 1, 2]] = 7.0, impulse, 7.0  # those at the ends are for transversality
        limits = by_hand.interval([1.25, -99.0], [1.5, 99.0])
        s = drift(drifting(), state_impulses=impulses, state_bounds=limits)
        assert _impulses(s, given_scales([s], 4.0)).value == pytest.approx(2.0 * room / 4.0, abs=1e-12)
    lone = drift(drifting(), breaks=(0.0, 2.0), state_impulses=np.full((2, 2), 5.0))
    assert _impulses(lone, given_scales([lone])).value == 0.0


@pytest.mark.parametrize("name", ["mixed", "pure", "u", "x[0]"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_multipliers_away_from_limits_count_by_room_share_and_worth(name: str, sign: float) -> None:
    """At the fifth of eight points, with limits 0.1 above and 0.2 below what is there."""
    problem = drifting(paths=True)
    base = drift(problem)
    j = 4
    t = base.leg.point_times[j]
    value = {"mixed": 1 + t - 6 * t, "pure": 2 - t**2, "u": -2 * t, "x[0]": 1 + t}[name]
    row = {"mixed": 0, "pure": 1, "u": 0, "x[0]": 0}[name]
    kind, n = {"mixed": ("path", 2), "pure": ("path", 2), "u": ("control", 1), "x[0]": ("state", 2)}[name]
    lower, upper, multipliers = np.full(n, -99.0), np.full(n, 99.0), np.zeros((n, 8))
    lower[row], upper[row], multipliers[row, j] = value - 0.2, value + 0.1, sign * 5.0
    leg = replace(
        base.leg,
        **{f"{kind}_bounds": by_hand.interval(lower, upper), f"{kind}_multipliers": multipliers},
    )
    s = PhaseSamples.of(leg, base.functions)
    solution = by_hand.solution(problem, leg)
    condition = complementarity(solution, [s], ends_of(solution), given_scales([s], cost=4.0))
    lasts = leg.rules[1].weights[j - 4] / 2 * 1.5
    room = 0.1 if sign > 0 else 0.2
    assert condition.value == pytest.approx(5.0 * room * lasts / 4.0, rel=1e-9)
    assert condition.where == f"phase leg, t = {t:.6g} s, multiplier of {name}"


def test_multipliers_of_boundary_constraints_away_from_limits() -> None:
    """Room 0.5 up and 0.25 down, no more than what the flight changes it; in shares of the largest worth of states."""
    problem = drifting()
    leg = problem.get_phase()
    problem.constrain("a", leg.final_state("x")[0], lower=2.75, upper=3.5)
    problem.constrain("b", leg.final_state("x")[1], upper=-2.0)
    s = drift(problem)
    for nu, amount, expected in ((2.0, 9.0, 1.0), (-2.0, 9.0, 0.5), (2.0, 0.3, 0.6), (-2.0, 0.2, 0.4)):
        solution = by_hand.solution(
            problem, s.leg, constraint_labels=("a", "b"), constraint_multipliers=np.array([nu, 7.0])
        )
        rows = ([amount, 1.0], [0.0, 0.0], [1.0, 1.0])
        scales = given_scales([s], cost=4.0, constraints=rows)
        found = complementarity(solution, [s], ends_of(solution), scales)
        assert found.value == pytest.approx(expected / 4.0, rel=1e-9)
        assert found.where == "multiplier of constraint a"


def test_adjoint_equation_segment_by_segment_and_at_jumps() -> None:
    """lam_0' = lam_1' = 0 is right: costates (3 - a t, 1) leave a times the segment, and jump by b."""
    for slope, jump in ((0.5, 0.0), (0.0, 0.25), (0.0, -0.25)):
        s = drift(
            drifting(),
            lam=lambda t, k, a=slope, b=jump: np.array([3 - a * t, 1.0 + b * k + 0 * t]),
        )
        condition = adjoint([s], given_scales([s], cost=4.0, radius=3.0), 1e-6)
        violation = slope * 1.5 if slope else abs(jump)
        assert condition.value == pytest.approx(violation * 3.0 / 4.0, rel=1e-9)
        where = (
            "segment 2 (0.5 to 2 s), adjoint equation of x[0]"
            if slope
            else "t = 0.5 s, jump of the costate of x[1]"
        )
        assert condition.where == f"phase leg, {where}"
    right = drift(drifting(), breaks=(0.0, 2.0), lam=lambda t, k: np.array([3.0 + 0 * t, 1.0 + 0 * t]))
    assert adjoint([right], given_scales([right]), 1e-6).value == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("value", "slope", "amount", "left"),
    [
        (1.0, 3.0, 4.0, 0.75),  # between its limits
        (1.0, -3.0, 4.0, 0.75),
        (0.0, 3.0, 4.0, 0.0),  # at the lower one, which pushes upwards
        (0.0, -3.0, 4.0, 0.75),
        (5.0, -3.0, 4.0, 0.0),
        (5.0, 3.0, 4.0, 0.75),
        (1.0, 0.0, 1.0, 0.0),  # nothing depends on it
    ],
)
def test_a_parameter_is_stationary_or_pushes_at_its_limit(
    value: float, slope: float, amount: float, left: float
) -> None:
    """In shares of what the cost changes by it, 0 <= k <= 5; of a trajectory that does not know of it."""
    problem = go.Problem("k")
    model = go.Model("one")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    k = problem.parameter("k", lower=0.0, upper=5.0)
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    problem.minimize(leg.final_state("x") + slope * k)
    one = (lambda t, k: np.array([t]),) * 3
    solution = by_hand.solution(problem, by_hand.phase(problem, *one), parameter_values=np.array([value]))
    found = parameters(solution, [], ends_of(solution), given_scales([], cost=amount, parameters=[1.0]))
    assert found.value == pytest.approx(left) and found.where == "parameter k"
