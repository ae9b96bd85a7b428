"""Controllers and the reports of their designs."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from gnc_opt.control import Controller, DesignReport, ReportEntry, initial_state_function, law_function
from gnc_opt.errors import ArgumentError, UnknownNameError
from gnc_opt.model import Layout, Variable


def controller(dt=0.5, **changes):
    t, x, r, z = ca.SX.sym("t"), ca.SX.sym("x", 2), ca.SX.sym("r", 1), ca.SX.sym("z", 1)
    fields = {
        "name": "by hand", "step": law_function(t, x, r, z, x[0] + 10 * r + 100 * z + 1000 * t, z + x[1]),
        "start": initial_state_function(t, x, r, x[1] + r + t), "states": Layout("state", (Variable("x", 2),)),
        "commands": Layout("command", (Variable("u"),)), "signals": Layout("signal", (Variable("s"),)),
        "memory": Layout("memory", (Variable("z"),)), "schedule": lambda times, dt: times[None, :] * dt,
        "explanation": DesignReport("by hand", (ReportEntry("k", 2.0),)), "dt": dt,
    }  # fmt: skip
    return Controller(**(fields | changes))


@pytest.mark.parametrize(
    "changes",
    [{"states": Layout("state", (Variable("x", 3),))}, {"commands": Layout("command", (Variable("u", 2),))},
     {"signals": Layout("signal", ())}, {"memory": Layout("memory", (Variable("z", 2),))}],
)  # fmt: skip
def test_a_law_has_the_sizes_of_its_layouts(changes):
    with pytest.raises(ArgumentError, match="its layouts require"):
        controller(**changes)


def test_explanations_are_read_by_name_and_printed():
    facts = (
        ReportEntry("gain", np.array([1.0, 2.5]), "N", "why"),
        ReportEntry("pole", -1.25),
        ReportEntry("law", "LQR", remark="best"),
    )
    explanation = DesignReport("title", facts)
    assert [str(f) for f in explanation] == ["gain: [1. , 2.5] N (why)", "pole: -1.25", "law: LQR (best)"]
    assert str(ReportEntry("third", np.array([1 / 3]))) == "third: [0.333]"
    assert str(ReportEntry("third", 1 / 3)) == "third: 0.333"
    assert str(ReportEntry("two", 2.0)) == "two: 2"
    assert str(ReportEntry("small", 1e-9, "s")) == "small: 1e-09 s"
    lines = str(explanation).splitlines()
    assert lines[0] == "title" and lines[1].split() == ["quantity", "value", "unit", "remark"]
    assert [line[: lines[1].index("value")].strip() for line in lines[2:]] == [f.name for f in facts]
    assert explanation["pole"] == -1.25
    with pytest.raises(UnknownNameError, match="no fact 'pale': did you mean 'pole'"):
        explanation["pale"]


def test_a_matrix_is_printed_by_rows_without_rounding_errors() -> None:
    gain = np.array([[3e3, -2e-11, 5e-5], [1e-9, 4.0, 2e-6]])
    lines = str(DesignReport("title", (ReportEntry("gain", gain, "N", "steady"),))).splitlines()
    assert [line.split() for line in lines[2:]] == [
        ["gain", "2", "rows:", "N", "steady"],
        ["3e+03,", "0,", "5e-05"],
        ["0,", "4,", "2e-06"],
    ]
