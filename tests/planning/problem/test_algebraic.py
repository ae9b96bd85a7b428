"""Algebraic variables against the same problem without them, and against a published one."""

from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from testing.models import dynamics, one_phase

import gnc_opt as go


def reorientation() -> go.Problem:
    """Minimum-time reorientation of a rigid body by 150 deg (Betts, Practical Methods for Optimal Control, 2010)."""
    inertia, angle = np.array([5621.0, 4547.0, 2364.0]), np.radians(150.0)
    model = go.Model("rigid body")
    omega, torque = model.state("omega", 3, unit="rad/s"), model.control("u", 3, unit="N m")
    q = model.state("q", 3)
    q4 = model.algebraic("q4", lambda q4: ca.dot(q, q) + q4**2 - 1.0)
    model.ode(
        {
            omega: (torque - ca.cross(omega, inertia * omega)) / inertia,
            q: 0.5 * (q4 * omega + ca.cross(q, omega)),
        }
    )
    problem, slew = one_phase("reorientation", model, initial=0.0, final=(10.0, 60.0), name="slew")
    slew.bounds(u=(-50.0, 50.0), q4=(-1.0, 1.0))
    slew.initial(omega=[0.0, 0.0, 0.0], q=[0.0, 0.0, 0.0])
    slew.final(omega=[0.0, 0.0, 0.0], q=[np.sin(angle / 2.0), 0.0, 0.0])
    slew.guess(q4=(1.0, np.cos(angle / 2.0)))
    problem.minimize(slew.final_time)
    return problem


@pytest.mark.slow
def test_reorientation_as_betts_states_it() -> None:
    found = go.solve(reorientation())
    assert found.objective == pytest.approx(28.630408, rel=2e-7)
    assert go.verify(found).ok
    times = np.linspace(0.0, found.objective, 50)
    q4 = found.control("q4")(times)
    assert np.sum(found.state("q")(times) ** 2, axis=0) + q4**2 == pytest.approx(np.ones(50), abs=1e-8)


def chemist(kind: str, *, phases: int = 1) -> go.Problem:
    """dx/dt = u - z with exp(z) = x, from x = 1 to 2, the least integral of u^2 + z^2."""
    model = go.Model("reactor")
    x, u = model.state("x"), model.control("u")
    if kind == "explicit":
        z = ca.log(x)
    elif (
        kind == "with a control"
    ):  # the same as z is u's sum with an algebraic variable: not followed as a state
        w = model.algebraic("w", lambda w: ca.exp(w + u) - x)
        z = w + u
    else:
        z = model.algebraic("z", lambda z: ca.exp(z) - x, unit="kg")
    model.ode({x: u - z})
    problem = go.Problem(kind)
    legs = [problem.phase(f"leg{k}", model) for k in range(phases)]
    for k, leg in enumerate(legs):
        leg.time(k / phases, (k + 1) / phases)
    for first, second in pairwise(legs):
        problem.link(first, second)
    legs[0].initial(x=1.0)
    legs[-1].final(x=2.0)
    problem.minimize(sum(leg.integral(u**2 + z**2) for leg in legs))
    return problem


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "phases"), [("algebraic", 2), ("with a control", 1)])
def test_same_as_without_the_variable(kind: str, phases: int) -> None:
    expected = go.solve(chemist("explicit"), check=False)
    found = go.solve(chemist(kind, phases=phases))
    assert found.objective == pytest.approx(expected.objective, rel=1e-8)
    assert found.objective_error.relative_error < 1e-6  # of controls that satisfy the equation
    assert go.verify(found).ok


@pytest.mark.slow
def test_samples_of_a_trajectory_name_it_as_a_control() -> None:
    solved = go.solve(chemist("explicit"), tol=1e-9, check=False)
    t = np.linspace(0.0, 1.0, 41)
    x, u = solved.state("x")(t), solved.control("u")(t)
    verdict = go.verify_trajectory(chemist("algebraic"), t, {"x": x}, {"u": u, "z": np.log(x)})
    assert verdict.ok, verdict.explain()


def test_wrong_uses_are_named() -> None:
    model = go.Model("wrong")
    x = model.state("x", 2)
    with pytest.raises(go.ModelError, match=r"is 3\.0: give a function of the variable"):
        go.Model("no function").algebraic("z", 3.0)  # type: ignore[arg-type]
    with pytest.raises(go.ModelError, match="index higher than 1"):
        model.algebraic("z", lambda z: x[0])
    with pytest.raises(go.ModelError, match=r"equation of algebraic variable 'y' .* 2 components: give 1"):
        model.algebraic("y", lambda y: x - y)
    z = model.algebraic("w", lambda w: w - x[0])
    model.ode({x: ca.vertcat(z, z)})
    leg = go.Problem("wrong").phase("leg", model)
    with pytest.raises(go.ProblemError, match="'w', which is an algebraic variable"):
        leg.rates(w=(-1.0, 1.0))


@pytest.mark.parametrize("curved", [True, False])
def test_the_estimated_error_does_not_depend_on_the_form_of_an_active_limit(curved: bool) -> None:
    """exp(z) >= x is z >= log(x); at the limit, only a change of z along it counts."""
    model, x, u, z = dynamics("reactor", "x", "u z", lambda x, u, z: {x: u - z})
    problem, leg = one_phase("limit", model, 0.0, 1.0)
    leg.initial(x=1.0)
    leg.final(x=2.0)
    leg.path("limit", ca.exp(z) - x if curved else z - ca.log(x), lower=0.0)
    problem.minimize(leg.integral(u**2 + z**2 + 3.0 * z))
    found = go.solve(problem)
    assert found.objective == pytest.approx(3.11183849, rel=1e-8)
    assert found.objective_error.relative_error < 1e-7
