"""Differences of states and the way back."""

import casadi as ca
import pytest

from gnc_opt.errors import ModelError
from gnc_opt.model import Model


def angle(retraction=None):
    model = Model("m")
    model.state("q")
    phi = model.state("phi")
    model.difference(phi, lambda x, ref: ca.atan2(ca.sin(x - ref), ca.cos(x - ref)), retraction)
    return model


def test_states_move_by_errors_and_differences_show_them():
    model = angle(lambda ref, e: ca.atan2(ca.sin(ref + e), ca.cos(ref + e)))
    x, e = ca.SX.sym("x", 2), ca.SX.sym("e", 2)
    moved = model.retraction_expression(x, e)
    found = ca.Function("f", [x, e], [moved, model.state_error_expression(moved, x)])([1.0, 3.0], [0.5, 0.4])
    assert found[0].full()[:, 0] == pytest.approx([1.5, 3.4 - 2 * 3.141592653589793])
    assert found[1].full()[:, 0] == pytest.approx([0.5, 0.4])


def test_states_with_a_difference_alone_do_not_move():
    x = ca.SX.sym("x", 2)
    with pytest.raises(
        ModelError, match=r"the retraction of state 'phi' in model 'm' is missing: give difference"
    ):
        angle().retraction_expression(x, x)
    model = angle(lambda ref, e: ref + e)
    model.difference("phi", lambda x, ref: x - ref)  # said anew, without
    with pytest.raises(ModelError, match="is missing"):
        model.retraction_expression(x, x)


@pytest.mark.parametrize("retraction", [lambda ref, e: ca.vertcat(ref, e), lambda ref, e: "phi"])
def test_what_is_no_state_is_refused(retraction):
    with pytest.raises(ModelError, match="the retraction of state 'phi'"):
        angle(retraction)
