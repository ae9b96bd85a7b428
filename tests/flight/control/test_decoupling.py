"""Decoupling matrices: exact inverses, and those of least length."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from gnc_opt.control import Reference, design_feedback_linearization
from gnc_opt.control.decoupling import Inverse, Memory, _solve
from gnc_opt.control.feedforward import StackedSchedule
from gnc_opt.errors import DesignError
from gnc_opt.model import Model, Variable
from gnc_opt.simulation import ClosedLoop


def test_inverses_are_exact_or_of_least_length():
    x = ca.SX.sym("x")
    square = ca.vertcat(ca.horzcat(x, 1), ca.horzcat(0, 2))
    wide = ca.horzcat(x, 2)
    for matrix, y in ((square, [3.0, 4.0]), (wide, [5.0])):
        f = ca.Function("f", [x], [_solve(matrix, ca.DM(y)), matrix])
        found, there = (np.array(v) for v in f(1.5))
        assert found.ravel() == pytest.approx(np.linalg.pinv(there) @ y)
    constant = _solve(ca.SX(ca.DM([[1.0, 2.0]])), ca.DM([5.0]))
    assert np.array(ca.evalf(ca.SX(constant))).ravel() == pytest.approx([1.0, 2.0])
    inverse = Inverse(wide, ca.SX(1), 1.0, 1.0)
    assert np.array(ca.Function("f", [x], [inverse(ca.DM([5.0]))])(1.0)).ravel() == pytest.approx([1.0, 2.0])
    assert Memory("m", ca.SX.sym("m", 3), 0, 0, "N").variable == Variable("m", 3, "N")
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


def test_a_control_that_comes_too_early_is_told_and_its_rate_will_do():
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
