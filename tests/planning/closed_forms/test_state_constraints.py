"""Active state constraints, as bounds on a state and as path constraints: costates, jumps and densities.

The meshes have boundaries at the entries and exits. Where a constraint is active with a vanishing multiplier,
the multipliers of an interior-point method converge like the square root of its tolerance only: 1e-12 leaves
1e-6.
"""

from __future__ import annotations

import numpy as np
import pytest
from testing.closed_forms import SCHEMES, Truth, assert_matches, constant, solve
from testing.models import dynamics, one_phase

import gnc_opt as go

on_schemes = pytest.mark.parametrize("scheme", SCHEMES)


def cart() -> go.Model:
    model, *_ = dynamics("cart", "x v", "u", lambda x, v, u: {x: v, v: u})
    return model


BRYSON_DENHAM_MESHES = {
    "two on the boundary": go.Mesh.at_times([0, 1 / 3, 1 / 2, 2 / 3, 1], [3, 4, 3, 5]),
    "uniform": go.Mesh.uniform(6, 3),
}


def bryson_denham(as_path: bool) -> go.Problem:
    """min 1/2 int u^2 from (0, 1) to (0, -1) in one second with x <= 1/9 (Bryson & Ho 1975, p. 120)."""
    problem, leg = one_phase("Bryson-Denham", cart(), initial=0.0, final=1.0)
    leg.initial(x=0.0, v=1.0)
    leg.final(x=0.0, v=-1.0)
    if as_path:
        leg.path("ceiling", leg.model.symbol("x") - 1 / 9, upper=0.0)
    else:
        leg.bounds(x=(None, 1 / 9))
    problem.minimize(leg.integral(leg.model.symbol("u") ** 2 / 2))
    return problem


def bryson_denham_truth() -> Truth:
    def arcs(before, on, after):
        return lambda t: np.where(t < 1 / 3, before(t), np.where(t < 2 / 3, on, after(t)))

    return Truth(
        4.0,
        states={
            "x": arcs(lambda t: (1 - (1 - 3 * t) ** 3) / 9, 1 / 9, lambda t: (1 - (3 * t - 2) ** 3) / 9),
            "v": arcs(lambda t: (1 - 3 * t) ** 2, 0.0, lambda t: -((3 * t - 2) ** 2)),
        },
        controls={"u": arcs(lambda t: 18 * t - 6, 0.0, lambda t: 12 - 18 * t)},
        costates={
            "x": arcs(lambda t: 18.0, 0.0, lambda t: -18.0),
            "v": arcs(lambda t: 6 - 18 * t, 0.0, lambda t: 18 * t - 12),
        },
        hamiltonian=constant(0.0),
    )


@on_schemes
@pytest.mark.parametrize("mesh", BRYSON_DENHAM_MESHES.values(), ids=BRYSON_DENHAM_MESHES)
def test_bryson_denham_with_a_bound(mesh: go.Mesh, scheme: str) -> None:
    """lam_x is 18, 0, -18: the bound pushes with impulses of 18 at both ends of the arc, not along it."""
    solution = solve(bryson_denham(as_path=False), mesh, scheme, tolerance=1e-12)
    assert solution.objective == pytest.approx(4.0, abs=1e-9)
    assert_matches(solution, bryson_denham_truth(), 3e-6)
    leg = solution.phase()
    exact = np.where(np.isclose(leg.breaks, 1 / 3) | np.isclose(leg.breaks, 2 / 3), 18.0, 0.0)
    np.testing.assert_allclose(leg.state_impulses[0, 1:-1], exact[1:-1], atol=1e-4)
    np.testing.assert_allclose(leg.state_multipliers[0] * 1e-2, 0.0, atol=1e-4)


@on_schemes
@pytest.mark.parametrize("mesh", BRYSON_DENHAM_MESHES.values(), ids=BRYSON_DENHAM_MESHES)
def test_bryson_denham_with_a_path_constraint(mesh: go.Mesh, scheme: str) -> None:
    """Points at the entry and exit carry the impulses of 18; LG has none there and stays too cheap."""
    solution = solve(bryson_denham(as_path=True), mesh, scheme, tolerance=1e-12)
    leg = solution.phase()
    rules = [rule.weights for rule in leg.collocation_rules]
    weights = np.concatenate([w * h / 2 for w, h in zip(rules, np.diff(leg.breaks), strict=True)])
    pushes = leg.path_multipliers[0] * weights
    assert np.all(pushes >= 0.0)
    if scheme == "LG":
        # Between the points the constraint is broken a little: the cost is too low, the pushes are smeared.
        assert 4.0 - 0.02 < solution.objective < 4.0
        assert np.sum(pushes) == pytest.approx(36.0, rel=0.02)
        return
    assert solution.objective == pytest.approx(4.0, abs=1e-9)
    assert_matches(solution, bryson_denham_truth(), 3e-6)
    for at in (1 / 3, 2 / 3):
        assert np.sum(pushes[np.isclose(leg.point_times, at)]) == pytest.approx(18.0, abs=1e-4)


LINE_MESHES = {
    "three on the boundary": go.Mesh.at_times([0, 1 / 3, 0.4, 0.6, 2 / 3, 1], [3, 5, 4, 3, 4]),
    "uniform": go.Mesh.uniform(6, 3),
}


def elastic_line(as_path: bool, final_time: float) -> go.Problem:
    """min int u^2 / 2 + 18 x, x' = u, x >= 0, from x = 1, back to 1 at t = 1 or free at t = 2/3."""
    model, x, u = dynamics("line", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("touch-down", model, initial=0.0, final=final_time)
    leg.initial(x=1.0)
    if final_time == 1.0:
        leg.final(x=1.0)
    if as_path:
        leg.path("floor", x, lower=0.0)
    else:
        leg.bounds(x=(0.0, None))
    problem.minimize(leg.integral(u**2 / 2 + 18 * x))
    return problem


def elastic_line_truth(final_time: float) -> Truth:
    def away(t):
        return np.maximum(1 / 3 - t, 0.0) + np.maximum(t - 2 / 3, 0.0)

    def slope(t):
        return 18 * (np.minimum(t - 1 / 3, 0.0) + np.maximum(t - 2 / 3, 0.0))

    return Truth(
        8.0 if final_time == 1.0 else 4.0,
        states={"x": lambda t: 9 * away(t) ** 2},
        controls={"u": slope},
        costates={"x": lambda t: -slope(t)},
        hamiltonian=constant(0.0),
    )


@on_schemes
@pytest.mark.parametrize(
    ("as_path", "final_time"),
    [(True, 1.0), (False, 2 / 3)],
    ids=["path, there and back", "bound, down to stay"],
)
@pytest.mark.parametrize("mesh", LINE_MESHES.values(), ids=LINE_MESHES)
def test_touch_down(mesh: go.Mesh, final_time: float, as_path: bool, scheme: str) -> None:
    """The floor pushes with the density -18 along the arc, without impulses; the costate vanishes there."""
    if final_time < 1.0:
        inside = [b for b in mesh.breaks if b < final_time - 1e-9]
        mesh = go.Mesh.at_times([*inside, final_time], list(mesh.degrees[: len(inside)]))
    solution = solve(elastic_line(as_path, final_time), mesh, scheme, tolerance=1e-12)
    assert_matches(solution, elastic_line_truth(final_time), 3e-5)
    leg = solution.phase()
    within = (leg.point_times > 1 / 3 + 1e-6) & (leg.point_times < 2 / 3 - 1e-6)
    densities = (leg.path_multipliers if as_path else leg.state_multipliers)[0]
    np.testing.assert_allclose(densities[within], -18.0, atol=1e-3)
    assert np.all(
        np.abs(densities[(leg.point_times < 1 / 3 - 1e-6) | (leg.point_times > 2 / 3 + 1e-6)]) < 1e-3
    )
    if not as_path:
        np.testing.assert_allclose(leg.state_impulses[0, 1:-1], 0.0, atol=5e-5)
        # Between the points of the arc the density is what the adjoint equation asks for.
        times = np.linspace(1 / 3 + 1e-6, 2 / 3 - 1e-6, 31)
        np.testing.assert_allclose(leg.state_multiplier(times)[0], -18.0, atol=1e-2)


@pytest.mark.parametrize("unit", [1.0, 1e5, 1e-5])
@pytest.mark.parametrize(("cut", "degrees"), [(0.4, (4, 3, 6, 4)), (0.6, (4, 6, 3, 4))])
def test_density_at_a_boundary_that_two_unequal_segments_share(
    cut: float, degrees: tuple[int, ...], unit: float
) -> None:
    """LGL states a path constraint twice there; both segments get the density -18, at the ends of the arc only one.

    In any unit, and beside a constraint that is never active.
    """
    problem = elastic_line(False, 1.0).with_bounds(x=(None, None))
    leg = problem.get_phase()
    leg.path("ceiling", leg.model.symbol("x"), upper=5.0)
    leg.path("floor", unit * leg.model.symbol("x"), lower=0.0)
    mesh = go.Mesh.at_times([0.0, 1 / 3, cut, 2 / 3, 1.0], list(degrees))
    solution = solve(problem, mesh, "LGL", tolerance=1e-12)
    expected = np.repeat([0.0, -18.0, -18.0, 0.0], degrees)
    np.testing.assert_allclose(unit * solution.phase().path_multipliers[1], expected, atol=2e-3)


def speed_limit() -> tuple[go.Problem, go.Phase]:
    """Rest to rest over 1 m in minimum time with |u| <= 1 and v <= 1/2: t_f = 5/2, switches at 1/2 and 2."""
    problem, leg = one_phase("speed limit", cart(), initial=0.0, final=(0.5, 10.0))
    leg.initial(x=0.0, v=0.0)
    leg.final(x=1.0, v=0.0)
    leg.bounds(u=(-1.0, 1.0), v=(None, 0.5))
    problem.minimize(leg.final_time)
    return problem, leg


def speed_limit_truth(found: np.ndarray) -> Truth:
    """``found``: the solution's two switches, equal to the exact ones up to rounding."""

    def arcs(before, on, after):
        return lambda t: np.where(t < found[0], before(t), np.where(t < found[1], on(t), after(t)))

    return Truth(
        2.5,
        states={
            "x": arcs(lambda t: t**2 / 2, lambda t: t / 2 - 1 / 8, lambda t: 1 - (2.5 - t) ** 2 / 2),
            "v": arcs(lambda t: t, lambda t: 0.5 + 0 * t, lambda t: 2.5 - t),
        },
        controls={"u": arcs(lambda t: 1.0 + 0 * t, lambda t: 0 * t, lambda t: -1.0 + 0 * t)},
        costates={"x": constant(-2.0), "v": arcs(lambda t: 2 * t - 1, lambda t: 0 * t, lambda t: 2 * t - 4)},
        hamiltonian=constant(-1.0),
    )


def test_speed_limit_with_movable_switches() -> None:
    """Density 2 along the arc, costates and H = -1 to 1e-8.

    In LG with 3 points: the control along the arc is free, and with movable boundaries other schemes and
    degrees find (to them) cheaper trajectories that break the limit between the points.
    """
    problem, leg = speed_limit()
    leg.hold([[1, 0, -1]])
    mesh = go.Mesh.at_times([0.0, 0.52, 1.97, 2.5], 3, movable=True)
    solution = solve(problem, mesh, "LG", tolerance=1e-11)
    found = solution.phase().breaks[1:-1]
    np.testing.assert_allclose(found, [0.5, 2.0], atol=1e-8)
    assert_matches(solution, speed_limit_truth(found), 1e-8)
    on = (solution.phase().point_times > 0.5 + 1e-6) & (solution.phase().point_times < 2 - 1e-6)
    np.testing.assert_allclose(solution.phase().state_multipliers[1][on], 2.0, atol=1e-7)


@on_schemes
@pytest.mark.parametrize("degree", [3, 5])
def test_speed_limit_on_a_fixed_mesh(degree: int, scheme: str) -> None:
    """t_f to 1e-8; lam_v = 0 on both sides of every boundary along the arc, the density there is -lam_x.

    The program's multipliers are not unique (see test_minimum_time), so lam_x is only near -2.
    """
    problem, _ = speed_limit()
    solution = solve(problem, go.Mesh.at_times([0, 0.5, 1.25, 2, 2.5], degree), scheme, tolerance=1e-11)
    leg = solution.phase()
    assert solution.objective == pytest.approx(2.5, abs=1e-8)
    lam_x = leg.lam_start[0, 0]
    assert lam_x == pytest.approx(-2.0, abs=0.1)
    np.testing.assert_allclose(leg.lam_start[1, 1:3], 0.0, atol=1e-8)
    np.testing.assert_allclose(leg.lam_end[1, 1:3], 0.0, atol=1e-8)
    np.testing.assert_allclose(leg.lam(np.linspace(0.51, 1.99, 40))[1], 0.0, atol=1e-8)
    on = (leg.point_times > 0.5 + 1e-6) & (leg.point_times < 2 - 1e-6)
    np.testing.assert_allclose(leg.state_multipliers[1][on], -lam_x, atol=1e-7)
    assert leg.state_impulses[1, 2] == pytest.approx(0.0, abs=1e-8)


def test_a_limit_that_another_one_implies_leaves_the_arcs_unique() -> None:
    """At rest until 2/5, then u = c (t - 2/5): v >= 0 keeps x >= 0, whose multiplier would not be unique.

    With a duration T of the motion, x(1) = c T^3 / 6 = 1/5 and v(1) = c T^2 / 2 = 1; the cost is 2 v^3 / (9 x).
    """
    problem, leg = one_phase("start from rest", cart(), initial=0.0, final=1.0)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=0.2, v=1.0)
    leg.bounds(x=(0.0, None), v=(0.0, None))
    problem.minimize(leg.integral(leg.model.symbol("u") ** 2 / 2))
    solution = go.solve(problem)
    assert solution.objective == pytest.approx(10 / 9, rel=1e-12) and solution.verdict.minimum
    assert [arc.channel for arc in solution.structure] == ["u", "u", "v"]
    assert solution.structure[-1].end == pytest.approx(0.4, abs=1e-8)
