"""Feedback linearization, and decoupling of inputs and outputs."""

from __future__ import annotations

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.spatial.transform import Rotation
from testing.controller_steps import decoupling_matrix, step_through

from gnc_opt.control import Reference, design_feedback_linearization, output_errors
from gnc_opt.control.decoupling_matrix_inverse import GuardedInverse, MemoryEntry, _solve_minimum_norm_system
from gnc_opt.control.feedback_linearization import _place_error_poles, _report_sampled_loop_stability
from gnc_opt.control.feedforward_and_reference_schedule import StackedSchedule
from gnc_opt.errors import DesignError, UnknownNameError
from gnc_opt.model import Model, Variable
from gnc_opt.simulation import ClosedLoop
from gnc_opt.spacecraft import quaternion_angle, quaternion_difference, quaternion_rate

# Feedback linearisation: exact linear errors, the wheel-driven slew of Navabi & Hosseini, singularities
# refused.


INERTIA = np.array([4.0, 4.0, 3.0])
K1, K2 = np.sqrt(0.001), np.sqrt(0.001 + 2 * np.sqrt(0.001))


def spacecraft(*, difference: bool = False) -> Model:
    """A body with wheels that starts at rest: the gyroscopic term vanishes identically. Scalar part first."""
    model = Model("spacecraft")
    q, w = model.state("q", 4), model.state("w", 3, unit="rad/s")
    torque = model.control("torque", 3, unit="N m")
    model.ode({q: quaternion_rate(q, w), w: torque / INERTIA})
    if difference:
        model.difference(q, quaternion_difference)
    return model


def slew(q_target, *, difference: bool = False, **options):
    model = spacecraft(difference=difference)
    reference = Reference.constant(model, [*q_target, 0, 0, 0], np.zeros(3))
    outputs = "q" if difference else {"q_v": model.symbol("q")[1:]}
    asked = {"poles": np.roots([1.0, K2, K1]), **options}
    return model, design_feedback_linearization(model, reference, outputs=outputs, **asked)


def about_z(angle_deg):
    half = np.radians(angle_deg) / 2
    return np.array([np.cos(half), 0, 0, np.sin(half)])


REST = np.array([1.0, 0, 0, 0, 0, 0, 0])


def test_gains_of_the_double_integrator_are_the_closed_form():
    _, controller = slew(about_z(20))
    gain = controller.explain()["K"]
    assert gain == pytest.approx(np.hstack([K1 * np.eye(3), K2 * np.eye(3)]), abs=1e-12)
    poles = controller.explain()["closed-loop poles"]
    assert np.abs(poles) == pytest.approx(0.17783, abs=1e-4)
    _, printed = slew(about_z(20), poles=np.roots([1.0, 0.2535, 0.0316]))
    assert np.abs(printed.explain()["closed-loop poles"].imag) == pytest.approx(0.12464, abs=1e-5)


def test_determinant_of_the_decoupling_matrix_is_the_scalar_part_over_384():
    model, random = spacecraft(), np.random.default_rng(1)
    for _ in range(20):
        q = random.normal(size=4)
        q /= np.linalg.norm(q)
        e = decoupling_matrix(model, {"q_v": model.symbol("q")[1:]}, [*q, *random.normal(size=3)])
        assert np.linalg.det(e) == pytest.approx(q[0] / 384, abs=1e-15)


def test_poles_by_output_or_by_component():
    """A name stands for all components of an output; a component's own poles go first; none at all is refused."""
    model = spacecraft()
    reference = Reference.constant(model, [*about_z(20), 0, 0, 0], np.zeros(3))

    def gain(**poles):
        design = design_feedback_linearization(
            model, reference, outputs={"q_v": model.symbol("q")[1:]}, poles={**poles}
        )
        return design.explain()["K"]

    alike = gain(q_v=[-1.0, -3.0])
    assert alike == pytest.approx(np.hstack([3 * np.eye(3), 4 * np.eye(3)]), abs=1e-12)
    one = gain(**{"q_v": [-1.0, -3.0], "q_v[1]": [-2.0, -5.0]})
    assert one == pytest.approx(np.hstack([np.diag([3.0, 10.0, 3.0]), np.diag([4.0, 7.0, 4.0])]), abs=1e-12)
    each = gain(**{f"q_v[{i}]": [-1.0, -3.0] for i in range(3)})
    assert each == pytest.approx(alike, abs=1e-12)
    with pytest.raises(DesignError, match=r"output 'q_v\[2\]' has no poles: give 2"):
        gain(**{f"q_v[{i}]": [-1.0, -3.0] for i in range(2)})


def test_zero_dynamics_are_neutral_in_four_dimensions_and_absent_on_the_sphere():
    _, plain = slew(about_z(20))
    _, sphere = slew(about_z(20), difference=True)
    assert plain.explain()["dimension of the zero dynamics"] == 1
    assert plain.explain()["eigenvalues of the zero dynamics"] == pytest.approx([0], abs=1e-12)
    assert sphere.explain()["dimension of the zero dynamics"] == 0


@pytest.mark.parametrize(
    ("angles", "eulerint"), [((20, -30, -40), 454.58), ((-30, -50, -45), 761.33), ((5, 5, 5), 77.48)]
)
def test_slews_agree_with_the_converged_integrals_of_the_published_manoeuvres(angles, eulerint):
    target = Rotation.from_euler("ZYX", angles[::-1], degrees=True).as_quat(scalar_first=True)
    k1, k2, dt = 0.0316, 0.2535, 0.005  # as printed
    model, controller = slew(target, poles=np.roots([1.0, k2, k1]), dt=dt)
    run = step_through(controller, model, REST, dt=dt, tf=60.0)
    alpha = np.degrees(quaternion_angle(run.x[:4], target[:, None]))
    assert trapezoid(alpha, run.times) == pytest.approx(eulerint, rel=1e-3)
    # v acts alike on all components: an eigenaxis slew, with a closed form in time
    zeta, wn = k2 / (2 * np.sqrt(k1)), np.sqrt(k1)
    wd = wn * np.sqrt(1 - zeta**2)
    left = np.exp(-zeta * wn * run.times) * (
        np.cos(wd * run.times) + zeta / np.sqrt(1 - zeta**2) * np.sin(wd * run.times)
    )
    start = np.radians(alpha[0])
    exact = np.abs(alpha[0] - 2 * np.degrees(np.arcsin((1 - left) * np.sin(start / 2))))
    assert alpha == pytest.approx(exact, abs=0.02)
    assert np.all(run.memory("singular") == 0)


def test_145_degrees_converge_and_150_degrees_raise_the_alarm_in_flight():
    brake = np.hstack([np.zeros((3, 4)), np.diag(0.5 * INERTIA)])
    # the overshoot of 4.1 % drives |q_v| to 1 for slews above 147.74 deg from the frame of the outputs
    for angle, alarm in ((145, 0), (150, 1)):
        model, controller = slew(about_z(angle), dt=0.02, fallback=brake)
        run = step_through(controller, model, REST, dt=0.02, tf=120.0)
        assert run.memory("singular")[0, -1] == alarm
        assert np.max(np.abs(run.x[4:, -1])) < 1e-3
        if not alarm:
            assert np.degrees(quaternion_angle(run.x[:4, -1], about_z(angle))) < 0.01


def test_the_error_quaternion_is_singular_at_half_a_turn_only():
    """As an output it takes slews that the absolute quaternion cannot."""
    target = about_z(170)
    model, controller = slew(target, difference=True, dt=0.02)
    run = step_through(controller, model, REST, dt=0.02, tf=120.0)
    assert np.degrees(quaternion_angle(run.x[:4, -1], target)) < 0.01
    assert run.memory("singular")[0, -1] == 0


def test_fallback_takes_over_where_the_law_cannot_work():
    """Half a turn off, a gain on the rate error brakes, and the last command is not repeated for ever."""
    gain = np.hstack([np.zeros((3, 3)), np.diag(0.5 * INERTIA)])
    _, controller = slew(about_z(0), difference=True, fallback=gain)
    x = np.array([0.0, 0, 0, 1.0, 0.01, -0.02, 0.03])
    u, z = controller(0.0, x, dt=1.0)
    assert z[controller.memory.slice("singular")] == 1
    assert u == pytest.approx(-0.5 * INERTIA * x[4:])


def crane() -> Model:
    model = Model("crane")
    x, v, length, winch, force = (
        model.state("x"), model.state("v"), model.state("length"), model.control("winch"),
        model.control("force"),
    )  # fmt: skip
    model.ode(
        {x: v, v: ca.exp(0.3 * x) * force - ca.sin(v) * length, length: winch * (1 + length**2) + 0.1 * force}
    )
    return model


def test_errors_are_linear_with_the_poles_asked_for_whatever_the_dynamics():
    """Mixed relative degrees and a moving reference: e of the position is that of (p + 1)(p + 3), to the step."""
    model = crane()

    def x(t):
        return [np.sin(t), np.cos(t), 2 + 0.2 * np.cos(2 * t)]

    def u(t):
        state = np.array(x(t))
        force = (-np.sin(t) + np.sin(state[1]) * state[2]) / np.exp(0.3 * state[0])
        return [(-0.4 * np.sin(2 * t) - 0.1 * force) / (1 + state[2] ** 2), force]

    reference = Reference.from_functions(model, x, u, 0.0, 4.0)
    worst = []
    for dt in (0.02, 0.01):
        controller = design_feedback_linearization(
            model, reference, outputs=["x", "length"], poles={"x": [-1, -3], "length": [-2]}, dt=dt
        )
        assert list(controller.explain()["relative degrees"]) == [2, 1]
        run = step_through(controller, model, np.add(x(0.0), [0.5, 0.0, -0.4]), dt=dt, tf=4.0, minor=2)
        e = run.x[0] - np.sin(run.times)
        exact = 0.5 * (1.5 * np.exp(-run.times) - 0.5 * np.exp(-3 * run.times))
        length = run.x[2] - 2 - 0.2 * np.cos(2 * run.times)
        worst.append([np.max(np.abs(e - exact)), np.max(np.abs(length + 0.4 * np.exp(-2 * run.times)))])
    ratio = np.array(worst[0]) / worst[1]
    assert np.all(np.array(worst[1]) < 0.02)
    assert np.all((ratio > 1.7) & (ratio < 2.4))  # of first order in the hold


def test_hopeless_designs_are_refused_with_numbers():
    with pytest.raises(DesignError, match="singular on the reference"):
        slew(about_z(180))
    with pytest.raises(DesignError, match="would not decay"):
        slew(about_z(20), poles=[0.1, -1.0])
    with pytest.raises(DesignError, match="give 2 poles, not 1"):
        slew(about_z(20), poles=[-1.0])
    with pytest.raises(DesignError, match="conjugate"):
        slew(about_z(20), poles=[-1.0 + 1j, -2.0])
    with pytest.raises(UnknownNameError, match="'p'"):
        slew(about_z(20), poles={"q_v": [-1.0, -2.0], "p": [-1.0, -2.0]})
    with pytest.raises(DesignError, match="control steps of 9 s are too long"):
        slew(about_z(20), dt=9.0)


def test_authority_is_compared_on_both_sides_of_a_jump():
    """The feedforward climbs to 0.995 and drops there: between two looks, and before the jump's own value."""
    model = Model("cart")
    v, a = model.state("v"), model.control("a")
    model.ode({v: a})
    reference = Reference.from_functions(
        model, lambda t: [0.5 * min(t, 0.995) ** 2], lambda t: [t if t < 0.995 else 0.0], 0.0, 1.0,
        jumps=[0.995],
    )  # fmt: skip

    def reserve(limit):
        controller = design_feedback_linearization(
            model, reference, outputs="v", poles=[-1.0], limits=(-limit, limit)
        )
        return controller.explain()["control authority margin"]

    assert reserve(0.997) == pytest.approx(0.002 / 0.997, rel=1e-5)
    with pytest.raises(DesignError, match=r"control 'a' needs 0\.995 at t = 0\.995 s"):
        reserve(0.993)


def chains(degrees, labels=("a", "b")):
    return SimpleNamespace(relative_degrees=degrees, labels=labels, n_outputs=len(degrees))


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ([-1.0], "give 2 poles, not 1"),
        ([-1.0, 2.0], "would not decay"),
        ([-1.0 + 1j, -1.0], "not in conjugate pairs"),
        ({"a": [-1.0, -2.0]}, "output 'b' has no poles"),
    ],
)
def test_dynamics_that_are_none_are_refused(choice, message):
    with pytest.raises(DesignError, match=message):
        _place_error_poles(chains((2, 2)), choice)


def cart(**units) -> Model:
    model = Model("cart")
    q, v = model.state("q", unit="m"), model.state("v", unit="m/s")
    a = model.control("a", unit="N")
    model.ode({q: v, v: a})
    model.output("twice", 2 * q, unit=units.get("unit", "m"))
    return model


def climbing(tail="hold"):
    return Reference.from_functions(cart(), lambda t: [t, 1.0], lambda t: [0.25], 0.0, 2.0, tail=tail)


def test_steps_too_long_for_the_poles_of_a_chain_are_refused():
    """e'' = -k1 e - k2 e' held over dt: the spectral radius of the sampled double integrator."""
    errors = output_errors(cart(), climbing(), "q")
    gain = np.array([[4.0, 4.0]])
    a, b = np.array([[1.0, 0.4], [0.0, 1.0]]), np.array([[0.08], [0.4]])
    (fact,) = _report_sampled_loop_stability(errors, gain, 0.4)
    assert fact.value == pytest.approx(np.max(np.abs(np.linalg.eigvals(a - b @ gain)))) and fact.value < 1
    assert _report_sampled_loop_stability(errors, gain, None) == []
    with pytest.raises(DesignError, match=r"control steps of 1\.1 s are too long"):
        _report_sampled_loop_stability(errors, gain, 1.1)


# Decoupling matrices: exact inverses, and those of least length.


def test_inverses_are_exact_or_of_least_length():
    x = ca.SX.sym("x")
    square = ca.vertcat(ca.horzcat(x, 1), ca.horzcat(0, 2))
    wide = ca.horzcat(x, 2)
    for matrix, y in ((square, [3.0, 4.0]), (wide, [5.0])):
        f = ca.Function("f", [x], [_solve_minimum_norm_system(matrix, ca.DM(y)), matrix])
        found, there = (np.array(v) for v in f(1.5))
        assert found.ravel() == pytest.approx(np.linalg.pinv(there) @ y)
    constant = _solve_minimum_norm_system(ca.SX(ca.DM([[1.0, 2.0]])), ca.DM([5.0]))
    assert np.array(ca.evalf(ca.SX(constant))).ravel() == pytest.approx([1.0, 2.0])
    inverse = GuardedInverse(wide, ca.SX(1), 1.0, 1.0)
    assert np.array(ca.Function("f", [x], [inverse(ca.DM([5.0]))])(1.0)).ravel() == pytest.approx([1.0, 2.0])
    assert MemoryEntry("m", ca.SX.sym("m", 3), 0, 0, "N").memory_variable == Variable("m", 3, "N")
    both = StackedSchedule(lambda t, dt: t[None, :], lambda t, dt: dt * t[None, :])
    assert both(np.array([1.0, 2.0]), 0.5).tolist() == [[1, 2], [0.5, 1]]


def car(extended: bool) -> Model:
    """A car steered by the rate of its wheel angle, driven by its acceleration or (extended) by the rate of that."""
    model = Model("car")
    x, y, heading, v, wheel = (model.state(k) for k in ("x", "y", "heading", "v", "wheel"))
    drive, steer = model.control("drive"), model.control("steer")
    motion = {x: v * ca.cos(heading), y: v * ca.sin(heading), heading: v * ca.tan(wheel), wheel: steer}
    pull = model.state("pull") if extended else None
    model.ode(motion | ({v: drive} if pull is None else {v: pull, pull: drive}))
    return model


def test_a_control_that_comes_too_early_is_reported():
    """The acceleration enters both positions before the steering does: the textbook's dynamic extension."""
    for extended in (False, True):
        model = car(extended)
        size = model.states.size
        straight = Reference.from_functions(
            model, lambda t, n=size: [2 * t, 0, 0, 2, 0, 0][:n], lambda t: [0, 0], 0.0, 5.0
        )
        if extended:
            law = design_feedback_linearization(
                model, straight, outputs=["x", "y"], poles=[-1, -2, -3], dt=0.05
            )
            run = ClosedLoop(model, law).simulate([0.3, -0.4, 0.2, 1.8, 0, 0], tf=5.0)
            assert run.states[:2, -1] == pytest.approx([10.0, 0.0], abs=0.05)
        else:
            with pytest.raises(
                DesignError, match=r"singular on the reference: .* make the control that enters first a state"
            ):
                design_feedback_linearization(model, straight, outputs=["x", "y"], poles=[-1, -2, -3])
