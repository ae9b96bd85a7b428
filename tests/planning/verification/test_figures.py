"""The verdict's figures to many digits: what an offence of known size is worth, by hand.

Minimum energy, rest to rest over 1 m in 1 s: a = 6 - 12 t, v = 6 t (1 - t), costates -12 and 12 t - 6, |v| <= 5,
|a| <= 10. Hence the scales: 1 m and 1.5 m/s, 12 m/s^2 (what a moves), 12 for the cost (|lam_q| q), 54 for H (|lam_v a|
+ a^2 / 2, at the ends), 36 for what the control does to it (6 m/s^2 to either side, slopes up to 6), 6 for the cost.
Minimum time over 1 m: lam_q = 1, lam_v = 1 - t, all scales of H are 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from testing.wrong_solutions import (
    added,
    bang_bang,
    double_integrator,
    energy,
    hilltop,
    moved,
    scaled,
    shifted,
    upper,
    with_leg,
)

import gnc_opt as go
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.planning.transcription.quadrature import collocation_rule

E = 1e-3
Q, V, A = 0, 1, 0
MIDDLE = collocation_rule("LG", 5).weights[2] / 2
"""Share of a segment that its middle point stands for; the eighth of the points is at 0.375 s, with v = 1.40625."""


def limited(low: float, high: float) -> go.Solution:
    return with_leg(energy(), control_bounds=Interval(np.array([low]), np.array([high])))


def multiplied(field: str, row: int, amount: float) -> go.Solution:
    values = getattr(energy().phase(), field)
    return with_leg(energy(), **{field: moved(values, (row, 7), amount)})


def enough(amount: float) -> go.Solution:
    return replace(energy(), constraint_multipliers=energy().constraint_multipliers + amount)


FIGURES: list[tuple[str, str, Callable[[], go.Solution], float]] = [
    ("dynamics", "control off for 0.25 s", lambda: added(energy(), "u", A, E, 1), E * 0.25 / 1.5),
    ("dynamics", "speed jumps", lambda: added(energy(), "x", V, E, 1), E / 1.5),
    ("propagation", "control off for 0.25 s", lambda: added(energy(), "u", A, E, 1), E * 0.25 / 1.5),
    ("propagation", "control off all along", lambda: added(energy(), "u", A, E), E / 1.5),
    ("bounds", "top speed", lambda: with_leg(
        energy(), state_bounds=upper(energy().phase().state_bounds, V, 1.5 - E)), E / 1.5),
    ("bounds", "least speed", lambda: with_leg(
        energy(), state_bounds=Interval(np.array([-9.0, E]), np.array([9.0, 5.0]))), E / 1.5),
    ("bounds", "largest control", lambda: limited(-10.0, 6 - E), E / (16 - E)),
    ("bounds", "least control", lambda: limited(-6 + E, 10.0), E / (16 - E)),
    ("path constraints", "top speed", lambda: with_leg(
        energy(), path_bounds=upper(energy().phase().path_bounds, 0, 1.5 - E)), E / 1.5),
    ("path constraints", "least speed", lambda: with_leg(
        energy(), path_bounds=Interval(np.array([E]), np.array([5.0]))), E / 1.5),
    ("boundary conditions", "final position too small", lambda: with_leg(
        energy(), final_bounds=shifted(energy().phase().final_bounds, E)), E),
    ("boundary conditions", "initial position too large", lambda: with_leg(
        energy(), initial_bounds=shifted(energy().phase().initial_bounds, -E)), E),
    ("boundary conditions", "duration", lambda: with_leg(
        energy(), duration_bounds=Interval(np.array([1.0 + E]), np.array([9.0]))), E),
    ("cost", "objective too large", lambda: replace(energy(), objective=6 * (1 + E)), E),
    ("cost", "objective too small", lambda: replace(energy(), objective=6 * (1 - E)), E),
    ("cost", "objective of 1", lambda: replace(hilltop(-0.5), objective=1 + E), E / 0.17),
    ("cost", "objective of 0.5", lambda: replace(hilltop(-0.5), objective=0.5), 0.5 / 0.17),
    ("adjoint equation", "costates jump there and back", lambda: scaled(energy(), "lam", 1 + E, 1), E / (1 + E)),
    ("Hamiltonian", "costate of q off where v is up to 1.5", lambda: added(energy(), "lam", Q, E, 1), 1.5 * E / 54),
    ("stationarity", "control off its minimum", lambda: added(energy(), "u", A, E, 1), E / 12),
    ("stationarity", "control off its minimum", lambda: added(energy(), "u", A, -E, 1), E / 12),
    ("Legendre-Clebsch", "curvature 1 over a span of 12", energy, -(12.0**2) / 36),
    ("control signs", "switch too early", lambda: added(bang_bang(), "lam", V, E), 2 * E / (1 + E)),
    ("control signs", "switch too late", lambda: added(bang_bang(), "lam", V, -E), 2 * E / (1 + E)),
    ("minimum principle", "switch too early", lambda: added(bang_bang(), "lam", V, E), 2 * E / (1 + 3 * E)),
    ("strict switches", "slope 1 over a range of 2, for 2 s", bang_bang, -4.0),
    ("complementarity", "control, pushed from above", lambda: multiplied("control_multipliers", A, E),
     E * 8.5 * MIDDLE / 36),
    ("complementarity", "control, pushed from below", lambda: multiplied("control_multipliers", A, -E),
     E * 11.5 * MIDDLE / 36),
    ("complementarity", "speed", lambda: multiplied("state_multipliers", V, E), E * 1.5 * MIDDLE / 12),
    ("complementarity", "path", lambda: multiplied("path_multipliers", 0, E), E * 1.5 * MIDDLE / 12),
    ("complementarity", "impulse", lambda: with_leg(
        energy(), state_impulses=moved(energy().phase().state_impulses, (V, 2), E)), E * 1.5 / 12),
    ("complementarity", "boundary constraint", lambda: enough(E), E / 12),
]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "what", "wrong", "value"), FIGURES, ids=[f"{n}: {w}" for n, w, *_ in FIGURES]
)
def test_figure(name: str, what: str, wrong: Callable[[], go.Solution], value: float) -> None:
    condition = go.verify(wrong())[name]
    assert condition.value == pytest.approx(value, rel=2e-5), condition.where


def test_transversality_of_values_and_times() -> None:
    """A costate of 6 at a free speed of 1.5 is worth 9 of 12; H = -18 at a free time is a third of its scale."""
    leg = energy().phase()
    free = Interval(np.array([1.0, -9.0]), np.array([1.0, 9.0]))
    verdict = go.verify(with_leg(energy(), final_bounds=free))
    assert verdict["transversality"].value == pytest.approx(0.75, rel=1e-6)
    late = Interval(np.array([0.1]), np.array([9.0]))
    for end, at in (("final", "end"), ("initial", "start")):
        box = late if end == "final" else Interval(np.array([-9.0]), np.array([9.0]))
        condition = go.verify(with_leg(energy(), **{f"{end}_time_bounds": box}))["transversality"]
        assert condition.value == pytest.approx(18 / 54, rel=1e-6)
        assert condition.where == f"phase leg, H at its {at}"
    assert leg.duration == 1.0


def far(reach: float = 100.0) -> go.Solution:
    """The same move over ``reach``, on one segment."""
    model = double_integrator()
    problem = go.Problem("far")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=reach, v=0.0)
    problem.constrain("reach", leg.final_state("q"), upper=5.0 * max(1.0, reach))
    problem.minimize(0.5 * leg.integral(model.symbol("a") ** 2))
    return go.solve(problem, mesh="1x6", tol=None)


@pytest.mark.parametrize(("reach", "room"), [(100.0, 100.0), (2.0, 2.0), (0.1, 0.1), (-100.0, 100.0)])
def test_room_of_a_boundary_constraint_is_at_most_what_the_flight_changes_it(
    reach: float, room: float
) -> None:
    """A multiplier of a hundredth of the costate 12 reach, on a limit far away; the costates are worth 12 reach^2."""
    solution = far(reach)
    wrong = replace(solution, constraint_multipliers=np.array([0.12 * abs(reach)]))
    expected = 0.12 * abs(reach) * room / (12 * reach**2)
    assert go.verify(wrong)["complementarity"].value == pytest.approx(expected, rel=1e-3)


def test_residual_of_the_costates_without_a_jump() -> None:
    """d(lam_v)/dt + lam_q is off by E for 1 s, at 1.5 m/s; the costates are worth 12 + E."""
    condition = go.verify(added(far(1.0), "lam", Q, E))["adjoint equation"]
    assert condition.value == pytest.approx(1.5 * E / (12 - E), rel=1e-5)
    assert condition.where.endswith("costate of v")


@pytest.mark.parametrize("reach", [100.0, -100.0, 0.1])
def test_boundary_values_are_missed_in_shares_of_what_the_flight_moves_them(reach: float) -> None:
    wrong = far(reach)
    target = Interval(np.array([reach + E, 0.0]), np.array([reach + E, 0.0]))
    wrong = with_leg(wrong, final_bounds=target)
    assert go.verify(wrong)["boundary conditions"].value == pytest.approx(E / abs(reach), rel=1e-5)


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e-3, -1.0])
@pytest.mark.parametrize(("place", "inside"), [(0.995, False), (0.97, True), (-0.995, False), (-0.97, True)])
def test_a_control_within_a_hundredth_of_its_range_of_a_bound_is_not_between(
    unit: float, place: float, inside: bool
) -> None:
    """H = 1 - u^2 / 2 curves downwards; along bounds of +-1, in any unit, that is no offence."""
    model = go.Model("integrator")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("hill")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-abs(unit), abs(unit)))
    problem.minimize(leg.integral(1 - 0.5 * (u / unit) ** 2))
    pinned = go.solve(problem.with_bounds(u=(place * unit, place * unit)), mesh="2x3", tol=None)
    box = Interval(np.array([-abs(unit)]), np.array([abs(unit)]))
    condition = go.verify(replace(with_leg(pinned, control_bounds=box), problem=problem))["Legendre-Clebsch"]
    assert condition.result is (go.ConditionResult.FAIL if inside else go.ConditionResult.PASS)


def test_smallest_share_that_counts_as_a_bound() -> None:
    """A control within a millionth of its range of a bound sits on it: dH/du may then have one sign."""
    solution = bang_bang()
    for distance, sits in ((1e-6, True), (4e-6, False)):
        inside = scaled(solution, "u", 1 - distance)
        assert (go.verify(inside)["stationarity"].value == 0.0) is sits


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_parameter_in_the_dynamics(sign: float) -> None:
    """x' = u + k from 0 to 1 in 1 s with the least u^2 / 2 + k^2 / 2: u = k = 1/2, lam = -1/2.

    Of k (1 + E) the derivative of the cost is E / 2. The cost changes by (0.9^2 - 0.5^2) / 2 if |k| grows by 0.4, a
    tenth of its range: 0.7 per k; |lam| adds 1/2.
    """
    model = go.Model("helped")
    x, u = model.state("x"), model.control("u")
    shift = model.parameter("k", 0.0)
    model.ode({x: u + sign * shift})
    problem = go.Problem("helped")
    k = problem.parameter("k", lower=-2.0, upper=2.0)
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    leg.final(x=1.0)
    problem.minimize(leg.integral(u**2 / 2) + k**2 / 2)
    solution = go.solve(problem, mesh="2x4", tol=None)
    assert solution.parameter_values[0] == pytest.approx(sign * 0.5, abs=1e-8)
    wrong = replace(solution, parameter_values=solution.parameter_values * (1 + E))
    assert go.verify(wrong)["parameters"].value == pytest.approx(E / 2 / 1.2, rel=1e-2)
