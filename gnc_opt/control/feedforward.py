"""Open loop: fly the reference's controls, whatever happens."""

from __future__ import annotations

import casadi as ca

from gnc_opt.arguments import expect
from gnc_opt.control.controller import Controller, first_memory, law
from gnc_opt.control.explanation import Explanation, Fact
from gnc_opt.control.reference import Reference
from gnc_opt.control.schedule import ReferenceSchedule, reference_signals
from gnc_opt.model.layout import Layout


def feedforward(reference: Reference) -> Controller:
    """Return the controller without feedback: the command is the mean of the reference's control over the step.

    Parameters
    ----------
    reference : Reference

    Returns
    -------
    Controller
        For any control step; it has no memory and ignores the measured state.

    Raises
    ------
    ArgumentError
        It is no reference.

    Examples
    --------
    >>> law = go.feedforward(go.Reference(solution))
    """
    expect(reference, Reference, "what feedforward() got", "write feedforward(Reference(solution))")
    signals = reference_signals(reference)
    states, controls = reference.states.size, reference.controls.size
    t, x = ca.SX.sym("t"), ca.SX.sym("x", states)
    r, z = ca.SX.sym("r", signals.size), ca.SX.sym("z", 0)
    return Controller(
        name="feedforward",
        step=law(t, x, r, z, r[states : states + controls], z),
        start=first_memory(t, x, r, z),
        states=reference.states,
        commands=reference.controls,
        signals=signals,
        memory=Layout("memory", (), "feedforward"),
        schedule=ReferenceSchedule(reference),
        span=(reference.initial_time, reference.final_time),
        explanation=Explanation(
            "feedforward (open loop)",
            (Fact("feedback", "none", remark="errors of the initial state and of the model stay or grow"),),
        ),
    )
