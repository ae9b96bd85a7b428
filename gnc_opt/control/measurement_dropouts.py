r"""Dropouts: commands during lost measurements.

A sample is *lost* if any of its numbers is not finite or exceeds `LARGEST` in magnitude. A law with dropout handling

1. repeats the last good sample for up to ``hold`` consecutive lost samples;
2. then, or before the first good sample, returns the safe command, raises ``invalid`` and keeps its memory;
3. resumes with the next good sample; the alarm stays raised.

A non-finite command or memory from a good sample is handled as in 2.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_integer, require_type
from gnc_opt.control.design_report import DesignReport, ReportEntry
from gnc_opt.control.discrete_time_controller import Controller, initial_state_function, law_function
from gnc_opt.errors import ArgumentError
from gnc_opt.model.model_variables import Layout, Variable, read_vector
from gnc_opt.numerical_tolerances import LARGEST

DEFAULT_HOLD_STEPS = 3
"""Default number of consecutive lost samples that a law bridges."""

INVALID = "invalid"
"""Name of the alarm."""

_NO_SAMPLE_YET = -1.0
"""Value of the counter of lost samples before the first good sample."""


def with_dropout_handling(
    controller: Controller, *, hold: int = DEFAULT_HOLD_STEPS, safe: ArrayLike | None = None
) -> Controller:
    """Return a controller with dropout handling; replaces the existing handling.

    Parameters
    ----------
    controller : Controller
        Controllers from design functions already have dropout handling with the default arguments.
    hold : int
        Largest number of consecutive lost samples replaced by the last good sample, >= 0.
    safe : array (n_commands,), optional
        Command after that; default: the feedforward of the schedule, or zero.

    Returns
    -------
    Controller
        Memory ``last_good`` (n_states,), ``lost`` (consecutive lost samples, -1 initially) and alarm ``invalid``.

    Raises
    ------
    ArgumentError
        Not a controller, an estimator-fed controller, invalid numbers, or a memory with one of these names.

    Examples
    --------
    >>> careful = with_dropout_handling(regulator, hold=1, safe=[0.0])
    >>> memory = careful.initial_memory(0.0, [1.0, 0.0])
    >>> for x in ([1.0, 0.0], [np.nan, 0.0], [np.nan, 0.0]):  # the last good sample once, then the safe command
    ...     u, memory = careful(0.0, x, memory)
    ...     print(np.round(u, 3))
    [-0.918]
    [-0.918]
    [0.]
    """
    require_type(
        controller,
        Controller,
        "the argument of with_dropout_handling()",
        "give the result of a design function",
    )
    if controller.estimated is not None:
        raise ArgumentError(
            f"'{controller.name}' includes an estimator, which handles dropouts: apply it to the controller inside."
        )
    hold = read_integer(hold, "the number of lost samples to bridge", 0)
    inner = controller.without_dropout_handling or controller
    given = (
        None if safe is None else read_vector(safe, inner.commands.size, "the safe command", ArgumentError)
    )
    if given is not None and not np.all(np.isfinite(given)):
        raise ArgumentError(f"the safe command is {given}: give finite numbers.")
    own = (
        *(Variable(f"last_good_{v.name}", v.size, v.unit) for v in inner.states.variables),
        Variable("lost", 1),
        Variable(INVALID, 1),
    )
    step, start = _build_law_for_measurement_dropouts(inner, inner.step, hold, given)
    unconstrained_law = inner.unconstrained_law
    if unconstrained_law is not None:
        unconstrained_law, _ = _build_law_for_measurement_dropouts(inner, unconstrained_law, hold, given)
    codegen_law = inner.codegen_law
    if codegen_law is not None:
        exported = with_dropout_handling(codegen_law.controller, hold=hold, safe=safe)
        codegen_law = replace(codegen_law, controller=exported)
    words = "the feedforward" if given is None else f"the command {given}"
    remark = f"missing samples replaced by the last good one; then {words} and the alarm '{INVALID}'"
    report = inner.explanation
    return replace(
        inner,
        step=step,
        start=start,
        memory=Layout("memory", (*inner.memory.variables, *own), f"controller '{inner.name}'"),
        alarms=(*inner.alarms, INVALID),
        explanation=DesignReport(
            report.title, (*report.facts, ReportEntry("dropouts", str(hold), remark=remark))
        ),
        without_dropout_handling=inner,
        codegen_law=codegen_law,
        unconstrained_law=unconstrained_law,
    )


def _build_law_for_measurement_dropouts(
    inner: Controller, bare: Any, hold: int, safe: Any
) -> tuple[Any, Any]:
    """Return law and initial memory of the controller with dropout handling, for the full or the unconstrained law."""
    states, size = inner.states.size, inner.memory.size
    kind = ca.SX if bare.is_a("SXFunction") and inner.start.is_a("SXFunction") else ca.MX
    t, x, r = kind.sym("t"), kind.sym("x", states), kind.sym("r", inner.signals.size)
    z = kind.sym("z", size + states + 2)
    memory, last, missed_steps, invalid = ca.vertsplit(
        z, [0, size, size + states, size + states + 1, size + states + 2]
    )
    seen = _is_vector_finite(x)
    # without a good sample, start() gets zeros; its result is not used
    first = inner.start(t, ca.if_else(seen, x, 0), r)
    usable = ca.logic_or(seen, ca.logic_and(missed_steps > _NO_SAMPLE_YET / 2, missed_steps < hold - 0.5))
    y = ca.if_else(seen, x, last)
    u, after, *valid = bare(t, y, r, ca.if_else(missed_steps < _NO_SAMPLE_YET / 2, first, memory))
    works = ca.logic_and(usable, ca.logic_and(_is_vector_finite(u), _is_vector_finite(after)))
    safe_command = _select_scheduled_feedforward(inner, r) if safe is None else ca.DM(safe)
    z_next = ca.vertcat(
        ca.if_else(works, after, memory),
        y,
        ca.if_else(seen, 0, ca.if_else(missed_steps < _NO_SAMPLE_YET / 2, _NO_SAMPLE_YET, missed_steps + 1)),
        ca.if_else(works, invalid, 1),
    )
    step = law_function(t, x, r, z, ca.if_else(works, u, safe_command), z_next, *valid)
    started = ca.if_else(seen, ca.vertcat(first, x), 0)
    return step, initial_state_function(t, x, r, ca.vertcat(started, ca.if_else(seen, 0, _NO_SAMPLE_YET), 0))


def _select_scheduled_feedforward(inner: Controller, r: Any) -> Any:
    """Return the feedforward in a row of the schedule; zero if the schedule has none."""
    names = [(f"{v.name}_ff", v.size) for v in inner.commands.variables]
    parts = [r[inner.signals.slice(n)] if n in inner.signals else ca.DM.zeros(size) for n, size in names]
    return ca.vertcat(*parts)


def _is_vector_finite(column: Any) -> Any:
    """Return 1 if all entries are finite and at most `LARGEST` in magnitude; comparisons with NaN are false."""
    return ca.sum1(ca.fabs(column) <= LARGEST) == column.shape[0]
