"""Flight code made smaller: single precision, with the error that this costs."""

import shutil

import casadi as ca
import numpy as np
import pytest
from testing.c_compiler import (
    NO_C,
    compiled,
    follower,
    holder,
    law_of,
    needs_compiler,
    pendulum,
    python,
    run,
    scalar_operations,
)
from testing.internals import FLOAT
from testing.mpc_designs import DT, A, B, tracker

import gnc_opt as go
from gnc_opt.errors import ArgumentError

SINGLE = ["-Wdouble-promotion", "-Wconversion", "-O0"]


def flight(law, count=40, seed=5):
    """Times and measurements beside a reference, and commands of the law."""
    times = law.span[0] + 0.1 * np.arange(count)
    measured = np.random.default_rng(seed).normal(size=(2, count))
    return times, measured, python(law, times, measured.T, 0.1)


@needs_compiler
@pytest.mark.parametrize("design", [follower, holder])
def test_single_precision_misses_the_law_by_what_is_reported(tmp_path, design):
    law = design(0.1)
    times, measured, expected = flight(law)
    options = {"precision": "float32", "samples": (times, measured)}
    code = go.export_c(law, tmp_path, **options)
    found = run(compiled(code, *SINGLE), times, measured.T)
    missed = np.max(np.abs(found - expected), axis=0)
    assert code.command_error == pytest.approx(missed, rel=0.5)
    size = np.max(np.abs(expected))
    assert 1e-9 * size < missed[0] < 2e-6 * size  # some roundings of 6e-8
    assert f"differ by at most {code.command_error[0]:.2g}" in code.header.read_text()
    whole = go.export_c(law, tmp_path, samples=(times, measured))
    assert whole.command_error[0] < 1e-13 * size
    assert code.table_bytes * 2 == whole.table_bytes


@needs_compiler
def test_single_precision_keeps_the_row_late_on_the_clock(tmp_path):
    """At 1e6 s single precision counts in steps of 0.06 s; times are double."""
    model, _ = pendulum()
    late = 1e6
    reference = go.Reference.from_functions(
        model, lambda t: [np.cos(t - late), 0.0], lambda t: [np.sin(t - late)], late, late + 3.0
    )
    law = go.design_tvlqr(model, reference, Q=1, R=1, dt=0.1)
    times = late + 0.1 * np.arange(20)
    states = np.zeros((20, 2))
    code = go.export_c(law, tmp_path, precision="float32")
    assert np.allclose(run(compiled(code, "-O0"), times, states), python(law, times, states, 0.1), rtol=1e-5)


@needs_compiler
def test_single_precision_of_a_quadratic_programme(tmp_path):
    law = tracker(rate_limits=5.0, state_limits={"v": (-0.5, 0.5)})
    x, z, states = np.array([3.0, 0.0]), None, []
    for k in range(40):
        states.append(x)
        u, z = law(k * DT, x, z)
        x = A @ x + B * u[0]
    options = {"precision": "float32", "samples": (DT * np.arange(40), np.transpose(states))}
    code = go.export_c(law, tmp_path, **options)
    compiled(code, *SINGLE)
    assert 1e-9 < code.command_error[0] < 1e-3


def test_refusals(tmp_path, monkeypatch):
    law = follower(0.1)
    good = (0.5 + 0.1 * np.arange(3), np.zeros((2, 3)))
    for options, message in (
        ({"precision": "float16"}, "no precision 'float16': did you mean"),
        (
            {"samples": (good[0], np.zeros((3, 2)))},
            r"shapes \(3,\) and \(3, 2\), and 'TVLQR' measures 2 states",
        ),
        ({"samples": good[0]}, "are no pair"),
    ):
        with pytest.raises(ArgumentError, match=message):
            go.export_c(law, tmp_path / "none", **options)
    with pytest.raises(ArgumentError, match="1e\\+300 is beyond the numbers of the type 'float'"):
        FLOAT(1e300)
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(go.GncOptError, match=r"no C compiler \(cc\) is found to compare"):
        go.export_c(law, tmp_path, samples=good)


@needs_compiler
def test_every_operation_has_its_single_form(tmp_path):
    t, x = ca.SX.sym("t"), ca.SX.sym("x", 2)
    values = [f(x[0], x[1]) for name, f in scalar_operations().items() if name not in NO_C]
    law = law_of([*values, t, ca.SX(3.5)], t, x)
    times, measured = 0.1 * np.arange(12), 2 * np.random.default_rng(8).normal(size=(2, 12))
    measured = measured.astype(np.float32).astype(float)  # the same numbers in both
    options = {"precision": "float32", "samples": (times, measured)}
    code = go.export_c(law, tmp_path, dt=0.1, **options)
    compiled(code, *SINGLE)
    size = np.max(np.abs(python(law, times, measured.T, 0.1)), axis=0)
    assert np.all(code.command_error <= 2e-5 * (1 + size))
    assert np.max(code.command_error) > 1e-8
