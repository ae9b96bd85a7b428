r"""Arcs on a curved state constraint, on the segments of a mesh, against a closed form.

Least effort in a field that pulls inwards, outside of the unit circle: min :math:`\int (a |x|^2 + |u|^2)/2\,dt`,
:math:`\dot x = u`, :math:`|x| \ge 1`, from distance 2 to distance 2 in time T. Nothing acts about the centre, so that
:math:`L = r^2 \dot\theta` is constant; r meets the circle with :math:`\dot r = 0`, and before
:math:`\dot r^2 = (r^2 - 1)(a + L^2/r^2)`, whose integrals are elementary. With :math:`b = L^2/a`:

* time on the way in :math:`t_1 = \operatorname{arsinh}\sqrt{3/(1 + b)} / \sqrt a`,
* angle on the way in :math:`\arctan\sqrt{3 b/(4 + b)}`, along the circle :math:`L (T - 2 t_1)`.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import spherical_in

import gnc_opt as go
from gnc_opt.planning import ArcKind, RefinementStatus
from gnc_opt.planning.refinement.arcs.arc_mesh import Plan
from gnc_opt.planning.refinement.arcs.detection import structures_of
from gnc_opt.planning.refinement.arcs.error_propagation import Decay, on_carrying_arcs
from gnc_opt.planning.refinement.arcs.loop import optimise_switches
from gnc_opt.planning.refinement.arcs.structure import PhaseStructure

A, L, T = 16.0, 0.8, 2.0
B = L**2 / A
WAY = math.asinh(math.sqrt(3.0 / (1.0 + B))) / math.sqrt(A)
ANGLE = 2.0 * math.atan(math.sqrt(3.0 * B / (4.0 + B))) + L * (T - 2.0 * WAY)
COST = (
    math.sqrt(A) * (math.sqrt(3.0 * (4.0 + B)) + (1.0 - B) * math.sqrt(A) * WAY)
    + (L**2 - A) * WAY
    + 0.5 * (A + L**2) * (T - 2.0 * WAY)
)


def circle() -> go.Problem:
    model = go.Model("point")
    x, u = model.state("x", 2), model.control("u", 2)
    model.ode({x: u})
    problem = go.Problem("outside of a circle")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=T)
    leg.initial(x=[2.0, 0.0])
    leg.final(x=[2.0 * math.cos(ANGLE), 2.0 * math.sin(ANGLE)])
    leg.path("circle", x.T @ x, lower=1.0)
    problem.minimize(leg.integral((A * x.T @ x + u.T @ u) / 2))
    return problem


@pytest.fixture(scope="module")
def coarse() -> go.Solution:
    return go.solve(circle(), mesh="16x5", tol=None)


def test_structure_on_the_segments_of_the_mesh(coarse: go.Solution) -> None:
    found, history = optimise_switches(coarse, tol=1e-8, segments="mesh")
    assert history.status is RefinementStatus.CONVERGED
    assert found.objective == pytest.approx(COST, rel=1e-9)
    (arc,) = [a for a in found.structure if a.channel == "circle" and a.kind.at_limit]
    assert (arc.start, arc.end) == pytest.approx((WAY, T - WAY), abs=1e-6)
    assert go.verify(found).ok
    assert all(p.segments >= coarse.phase("leg").mesh.segments for p in history.passes)


def test_an_error_comes_back_from_the_segment_in_which_it_arises(coarse: go.Solution) -> None:
    # The arc begins inside of a segment: what that leaves out returns at each later end, with (-1)^5.
    leg = coarse.phase("leg")
    first = int(np.searchsorted(leg.breaks, WAY)) - 1
    last = int(np.searchsorted(leg.breaks, T - WAY)) - 1
    beyond = np.sum(leg.x(leg.breaks) ** 2, axis=0) - 1.0
    along = beyond[first + 1 : last + 1]
    assert abs(along[0]) > 1e-6
    assert along[1:] == pytest.approx(-along[:-1], rel=0.1)

    carrying = np.zeros(leg.mesh.segments, dtype=bool)
    carrying[first:last] = True
    own = Decay.of(coarse.samples()["leg"]).own_errors(carrying, np.ones(carrying.size))
    assert own[first] == 1.0
    assert np.max(own[first + 1 : last]) < 0.1
    assert np.all(own[~carrying] == 1.0)


def test_segments_of_the_mesh_are_kept(coarse: go.Solution) -> None:
    mesh = go.Mesh((0.0, 0.1, 0.3, 0.31, 0.6, 1.0), (5, 6, 7, 8, 9))
    structure = structures_of(coarse)["leg"].at((0.0, 0.621, 1.2, 2.0))
    assert list(on_carrying_arcs(structure)) == [False, True, False]
    plan = Plan.on_mesh(structure, mesh)
    # The piece ends so close behind 0.31 that this is left out; the others keep their place and their degree.
    assert plan.mesh().breaks == pytest.approx((0.0, 0.1, 0.3, 0.3105, 0.6, 1.0))
    assert plan.mesh().degrees == (5, 6, 7, 8, 9)
    finer = plan.resolutions[0].with_points(np.array([3, 40, 0]))
    assert finer.each == (8, 6, 6, 6, 6, 7)
    assert 0.3105 * finer.shares == pytest.approx([0.0, 0.1, 0.15, 0.2, 0.25, 0.3, 0.3105])


def test_only_limits_without_controls_carry_errors_on() -> None:
    both = PhaseStructure(
        (0.0, 1.0, 2.0),
        (
            (ArcKind.INTERIOR, ArcKind.UPPER, ArcKind.INTERIOR),
            (ArcKind.INTERIOR, ArcKind.INTERIOR, ArcKind.LOWER),
        ),
        n_controls=1,
        n_paths=2,
        orders=(0, 0, 2),
    )
    assert list(on_carrying_arcs(both)) == [False, True]


def test_blame_is_shared_along_carrying_arcs_alone() -> None:
    decay = Decay(np.array([1e-9, 1e-3, 1e-5]), np.ones(3))
    own = decay.own_errors(np.array([False, True, True]), np.array([7.0, 2.0, 3.0]))
    assert own == pytest.approx([7.0, 3.0, 0.03])


def test_coefficients_of_a_hyperbolic_cosine_fall_as_fast_as_said() -> None:
    """Least integral of x^2 + u^2 with x(-1) = x(1) = 1: x = cosh t / cosh 1, whose odd coefficients vanish."""
    model = go.Model("point")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("even")
    leg = problem.phase("leg", model)
    leg.time(initial=-1.0, final=1.0)
    leg.initial(x=1.0)
    leg.final(x=1.0)
    problem.minimize(leg.integral(x**2 + u**2))
    decays = [Decay.of(go.solve(problem, mesh=f"1x{n}", tol=None).samples()["leg"]) for n in (4, 6)]
    # Of cosh t the even coefficients are (2 n + 1) i_n(1), with modified spherical Bessel functions i_n.
    n = np.array([4, 6])
    expected = (2 * n + 1) * spherical_in(n, 1.0)
    assert decays[1].left[0] / decays[0].left[0] == pytest.approx(expected[1] / expected[0], rel=0.2)
    mean = np.log10(spherical_in(0, 1.0) / expected) / (n - 1)
    assert [d.rates[0] for d in decays] == pytest.approx(mean, rel=0.2)
