"""The rendezvous: reference times, structure, symmetry, traps, orbital model."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from testing.second_order import second_order_of

import gnc_opt as go
from problems import rendezvous

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def case_1() -> go.Solution:
    return go.solve(rendezvous.build(), mesh=rendezvous.MESH, tol=None)


@pytest.mark.parametrize(
    ("case", "exact"),
    [(1, 25.8699620765), (2, 26.16569), (3, 25.9323677271), (4, 25.6589517308), (5, 28.71481)],
)
def test_the_papers_times_are_local_minima_on_its_mesh(case: int, exact: float) -> None:
    """60 points cost 1.4 to 4 ms beside exact switch times; what these are comes from another program's search.

    In cases 2 and 5 the paper's is the third and the fourth local minimum of 2800 random starts. Its GPOPS column is
    the best or the second one, 26.03353, 26.16518 and 25.89860 s in cases 2 to 4, to the digits printed.
    """
    printed = rendezvous.REFERENCE[case, "printed"]["paper GPM"].value
    assert 1.4e-3 < printed - exact < 4e-3
    gpops = {1: exact, 2: 26.03353, 3: 26.16518, 4: 25.89860, 5: 28.27843}[case]
    printed = rendezvous.REFERENCE[case, "printed"]["paper GPOPS"].value
    assert printed == pytest.approx(gpops, abs=5e-3 if case == 1 else 1e-4)


def test_parameters_of_the_chaser_can_be_dispersed_without_a_new_build() -> None:
    """A heavier chaser needs more time; scaling inertia and torque together changes nothing."""
    problem = rendezvous.build(3)
    nominal = go.solve(problem, mesh=rendezvous.MESH, tol=None)
    heavy = go.solve(problem.with_parameters(mass=1.1 * rendezvous.MASS), mesh=rendezvous.MESH, tol=None)
    assert heavy.statistics.compiled_before
    assert heavy.objective > nominal.objective + 0.1
    scaled = problem.with_parameters(inertia=2 * np.array(rendezvous.INERTIA)).with_bounds(
        T_B=(-2 * rendezvous.MAX_TORQUE, 2 * rendezvous.MAX_TORQUE)
    )
    # Same problem in other units of torque: equal up to the solver's tolerance.
    assert go.solve(scaled, mesh=rendezvous.MESH, tol=None).objective == pytest.approx(
        nominal.objective, abs=1e-6
    )


@pytest.mark.parametrize("case", rendezvous.CASES)
def test_switch_times_steer_the_chaser_to_its_target(case: int) -> None:
    """The tabulated bang-bang controls, integrated as they stand, meet the final state.

    The times are rounded by up to 5e-7 s: 19 of them, each worth 0.2 m/s^2 or 0.04 rad/s^2 over up to 26 s,
    leave less than 1e-4 m, m/s, rad or rad/s.
    """
    problem = rendezvous.build(case)
    edges = (
        np.array(rendezvous.switch_mesh(case).breaks) * rendezvous.REFERENCE[case, "printed"]["exact"].value
    )
    limits = np.repeat([rendezvous.MAX_TORQUE, rendezvous.MAX_FORCE], 3)
    controls: Array = limits[:, None] * rendezvous.switch_arcs(case)
    model = problem.get_phase().model
    x = np.concatenate([np.zeros(9), rendezvous.CASES[case]])
    for k in range(edges.size - 1):
        u = controls[:, k]

        def rate(t: float, x: Array, u: Array = u) -> Array:
            return model.f(t, x, u)

        x = solve_ivp(rate, edges[k : k + 2], x, method="DOP853", rtol=1e-11, atol=1e-11).y[:, -1]
    target = np.concatenate([np.zeros(3), rendezvous.FINAL_SIGMA, np.zeros(3), rendezvous.FINAL_POSITION])
    np.testing.assert_allclose(x, target, atol=1e-4)


@pytest.mark.parametrize(("case", "equation"), [(1, "printed")])
def test_movable_switches_reach_the_reference_and_pass_every_condition(
    case: int, equation: rendezvous.Equation
) -> None:
    """From the paper's mesh to one whose boundaries sit on the switches."""
    problem = rendezvous.build(case, equation)
    solution = go.solve(
        problem.with_fixed_arcs(arcs=rendezvous.switch_arcs(case)),
        mesh=rendezvous.switch_mesh(case, 9, movable=True),
        guess=go.solve(problem, mesh=rendezvous.MESH, tol=None),
        options=go.SolverOptions(
            tolerance=1e-10
        ),  # the guard on sigma is never active; its barrier shows at 1e-9
    )
    reference = rendezvous.REFERENCE[case, equation]["exact"]
    assert solution.objective == pytest.approx(reference.value, abs=1e-9)
    verdict = go.verify(solution, tol=1e-6)
    assert verdict.minimum, verdict.explain()
    hamiltonian = np.asarray(solution.hamiltonian(solution.phase().sample_times(20)))
    np.testing.assert_allclose(hamiltonian, -1.0, atol=1e-6)


def test_verdict_on_the_papers_mesh_names_what_60_points_leave(case_1: go.Solution) -> None:
    verdict = go.verify(case_1)
    failed = {condition.name for condition in verdict.failed}
    assert {"dynamics", "minimum principle"} <= failed
    assert not {"boundary conditions", "limits"} & failed
    # The cell of a node beside a switch reaches past it: a wrong sign there, and only there, is the mesh's.
    assert verdict["active set"].value < 5e-3
    # 1 % of H: larger would be another extremal, smaller is more than a switch within a node's reach permits.
    assert 1e-3 < verdict["stationarity"].value < 5e-2


MIRROR_STATES = np.array([-1, 1, -1, -1, 1, -1, 1, -1, 1, 1, -1, 1])
"""Mirror at the orbital plane: rates and attitude about x and z, motion along y change sign."""
MIRROR_CONTROLS = np.array([-1, 1, -1, 1, -1, 1])


def test_case_1_has_a_mirror_twin() -> None:
    problem = rendezvous.build(1)
    push = 0.1 * rendezvous.MAX_FORCE
    one, other = (
        go.solve(problem.with_guess(F_B=[0.0, side * push, 0.0]), mesh=rendezvous.MESH, tol=None)
        for side in (1, -1)
    )
    assert one.objective == pytest.approx(other.objective, abs=1e-7)
    t = np.linspace(0.0, min(one.objective, other.objective), 50)
    x, twin = one.phase().x(t), other.phase().x(t)
    assert np.max(np.abs(x[10])) > 1.0  # it leaves the orbital plane by more than a metre
    # The cost is flat in some directions (reduced Hessian 1e-4): 1e-9 in the cost is 1e-5 in the states.
    np.testing.assert_allclose(MIRROR_STATES[:, None] * twin, x, atol=1e-4)


def test_dynamics_are_symmetric_about_the_orbital_plane() -> None:
    random = np.random.default_rng(3)
    x, u = 0.3 * random.standard_normal(12), 10 * random.standard_normal(6)
    for equation in rendezvous.EQUATIONS:
        model = rendezvous.chaser_model(equation)
        np.testing.assert_allclose(
            model.f(0.0, MIRROR_STATES * x, MIRROR_CONTROLS * u),
            MIRROR_STATES * model.f(0.0, x, u),
            atol=1e-15,
        )


def test_the_plane_of_symmetry_holds_a_saddle_that_the_default_guess_avoids(case_1: go.Solution) -> None:
    """Confined to the plane the best is 27.185 s; that stays a KKT point when the confinement is lifted."""
    problem = rendezvous.build(1)
    torque, force = rendezvous.MAX_TORQUE, rendezvous.MAX_FORCE
    confined = problem.with_bounds(
        T_B=([0.0, -torque, 0.0], [0.0, torque, 0.0]), F_B=([-force, 0.0, -force], [force, 0.0, force])
    )
    planar = go.solve(confined, mesh=rendezvous.MESH, tol=None)
    assert planar.objective == pytest.approx(27.185, abs=1e-3)
    lifted = go.solve(problem, mesh=rendezvous.MESH, guess=planar)
    assert lifted.objective == pytest.approx(planar.objective, abs=1e-6)
    assert not go.verify(lifted).minimum
    # The controls across the plane are singular, and pulses of them gain time.
    assert second_order_of(lifted)["generalised Legendre-Clebsch"].result is go.ConditionResult.FAIL
    assert case_1.objective < planar.objective - 1.0
