"""Machine code of a loop: the interpreter's bits, or the interpreter."""

from __future__ import annotations

import itertools
import pickle
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.internals import StepExecutor
from testing.loops import double_integrator

from gnc_opt.control import Controller, design_lqr, design_mpc
from gnc_opt.errors import GncOptError
from gnc_opt.model import Model
from gnc_opt.simulation import (
    ClosedLoop,
    CompiledLoop,
    Event,
    Lag,
    Noise,
    PiecewiseConstantNoise,
    monte_carlo,
)
from gnc_opt.simulation import compiled_closed_loop as flight_module
from gnc_opt.simulation import control_step_execution as module

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(flight_module, "MIN_EVALUATIONS_TO_COMPILE", 100)
    return tmp_path / "gnc_opt"


def loop(through: float | None = None, weight: float = 1) -> ClosedLoop:
    plant = double_integrator()
    events = [] if through is None else [Event("through", plant.symbol("q") - through, "falling")]
    regulator = design_lqr(plant, [0, 0], Q=weight, R=1, dt=0.1, integral={"q": 0.1})
    noise, gust = Noise("gauge", 1e-3, on="q"), PiecewiseConstantNoise("gust", 0.1, 0.7, on="a")
    return ClosedLoop(plant, regulator, [Lag("lag", 0.2)], [noise], [gust], events=events)


def flown(through: float | None = None, weight: float = 1) -> CompiledLoop:
    return loop(through, weight).compile([1.0, 0.0], t0=0.0, tf=5.0)


def bits(flight: CompiledLoop) -> list[bytes]:
    P = flight.nominal[:, None] * np.array([1.0, 1.01, np.nan])
    ending = flight.final_values(P, [1, 2, 3])
    return [
        np.asarray(v).tobytes()
        for v in (ending.states, ending.memory, ending.effort, ending.variation, ending.errors)
    ]


@needs_compiler
@pytest.mark.parametrize("through", [0.5])
def test_machine_code_has_the_bits_of_the_interpreter(cache: Path, through: float | None) -> None:
    flight = flown(through)
    quick = flight.with_machine_code(2)
    assert {Path(p).parent for p in quick.libraries} == {cache} and not any(flight.libraries)
    assert bits(quick) == bits(flight) and quick.fingerprint == flight.fingerprint
    assert bits(pickle.loads(pickle.dumps(quick))) == bits(flight)


_ONE = (
    *(
        ca.sqrt,
        ca.exp,
        ca.log,
        ca.expm1,
        ca.log1p,
        ca.sin,
        ca.cos,
        ca.tan,
        ca.asin,
        ca.acos,
        ca.atan,
        ca.sinh,
        ca.cosh,
    ),
    *(
        ca.tanh,
        ca.asinh,
        ca.acosh,
        ca.atanh,
        ca.floor,
        ca.ceil,
        ca.fabs,
        ca.sign,
        lambda a: -a,
        lambda a: a**2,
    ),
    *(lambda a: 2 * a, lambda a: 1 / a, lambda a: a**3.5, ca.logic_not),
)
_TWO = (
    *(lambda a, b: a + b, lambda a, b: a - b, lambda a, b: a * b, lambda a, b: a / b, lambda a, b: a < b),
    *(
        lambda a, b: a <= b,
        lambda a, b: a == b,
        lambda a, b: a != b,
        ca.logic_and,
        ca.logic_or,
        lambda a, b: ca.if_else(a, b, 0),
    ),
    *(ca.copysign, ca.atan2, lambda a, b: a**b, ca.fmin, ca.fmax, ca.hypot, ca.fmod),
    *(lambda a, b: ca.if_else(a > 0.3, b, np.inf), lambda a, b: ca.if_else(a > 0.3, b, np.nan)),
)
_SPECIAL = (0.0, -0.0, 0.5, -0.5, 1.0, 1.5, 7.25, -1e300, 5e-324, np.inf, -np.inf, np.nan)


@needs_compiler
def test_machine_code_has_the_bits_of_the_interpreter_for_every_operation() -> None:
    """With numbers of all kinds."""
    x, w, c = ca.SX.sym("x", len(_ONE) + len(_TWO)), ca.SX.sym("w", 2), ca.SX.sym("c", 2)
    a, b = w[0] + c[0] * x[0], w[1] + c[1] * x[0]
    results = [*(f(a) for f in _ONE), *(f(a, b) for f in _TWO)]
    step = ca.Function("step", [x, w, c], [ca.vertcat(*results)])
    fly = module.load_control_step_library(module.build_control_step_library(step))
    assert fly is not None
    X, C = np.zeros(x.shape[0]), np.array([1.0, 2.0])
    X[0] = 0.75
    final = np.empty_like(X)
    for known in itertools.product(_SPECIAL, _SPECIAL):
        row = np.array([known])
        assert fly(X, row, C, final) == 1
        told = np.ravel(step(X, row[0], C).full())
        assert np.array_equal(final, told, equal_nan=True)
        assert np.array_equal(np.signbit(final[told == 0]), np.signbit(told[told == 0]))


@pytest.mark.parametrize("why", ["no compiler", "it fails", "no place", "no C"])
def test_without_machine_code_the_interpreter_flies(
    cache: Path, monkeypatch: pytest.MonkeyPatch, why: str
) -> None:
    flight = flown()
    if why == "no compiler":
        monkeypatch.setattr(shutil, "which", lambda _: None)
    elif why == "it fails":
        broken = shutil.which("false")
        monkeypatch.setattr(shutil, "which", lambda _: broken)
    elif why == "no place":
        cache.write_text("a file")
    else:
        monkeypatch.setattr(module, "_compile_control_step_library", _refuse)
    quick = flight.with_machine_code(2)
    assert quick.libraries == ("", "") and bits(quick) == bits(flight)


@needs_compiler
def test_a_solver_that_has_no_c_is_left_to_the_interpreter_without_a_word(
    cache: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    plant, law = predictive()
    flight = (
        ClosedLoop(plant, replace(law, unconstrained_law=None))
        .compile([1.0, 0.0], t0=0.0, tf=2.0)
        .with_machine_code(10)
    )
    assert flight.libraries == ("", "") and list(cache.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def predictive() -> tuple[Model, Controller]:
    plant = double_integrator()
    limits: dict[str, Any] = {"limits": (-0.5, 0.5), "state_limits": {"v": (-0.3, 0.3)}}
    return plant, design_mpc(plant, [0, 0], Q=1, R=1, horizon=0.5, dt=0.1, **limits)


@needs_compiler
@pytest.mark.parametrize("through", [0.01])
def test_steps_at_which_a_law_asks_its_solver_are_the_interpreters_and_no_others(
    monkeypatch: pytest.MonkeyPatch, through: float | None
) -> None:
    """From 1 m a limit is in reach for 2 s and no more; the speed reaches its limit on the way."""
    plant, law = predictive()
    events = [] if through is None else [Event("through", plant.symbol("q") - through, "falling")]
    noise = [Noise("gauge", 1e-3, on="q")]
    flight = ClosedLoop(plant, law, sensors=noise, events=events).compile([1.0, 0.0], t0=0.0, tf=8.0)
    quick = flight.with_machine_code(2)
    assert all(quick.libraries) and bits(quick) == bits(flight)
    asked = flight.run(flight.nominal, 1).commands
    interpreted: list[int] = []
    interpret = StepExecutor._simulate_steps_in_casadi
    monkeypatch.setattr(
        StepExecutor, "_simulate_steps_in_casadi", lambda *a: interpreted.append(len(a[2])) or interpret(*a)
    )
    quick.final_values(flight.nominal[:, None], [1])
    at_limit = np.sum(np.abs(asked[0]) > 0.5 - 1e-9)
    assert set(interpreted) == {1} and 2 * max(3, at_limit) <= len(interpreted) < 120


def _refuse(*_: Any) -> None:
    raise RuntimeError("no code generation for this operation")


@needs_compiler
def test_machine_code_of_other_bits_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    library = module.build_control_step_library(flown(weight=2)._step_executors[0].step_function_without_log)
    monkeypatch.setattr(flight_module, "build_control_step_library", lambda _: library)
    assert library and flown().with_machine_code(2).libraries == ("", "")


@needs_compiler
def test_campaigns_use_it(monkeypatch: pytest.MonkeyPatch) -> None:
    mission: dict[str, Any] = {"x0": [1.0, 0.0], "tf": 5.0, "seed": 3, "executor": "serial"}
    quick = monte_carlo(loop(), 4, **mission)
    assert quick.compiled_loop is not None and all(quick.compiled_loop.libraries)
    monkeypatch.setattr(flight_module, "MIN_EVALUATIONS_TO_COMPILE", 10_000)
    plain = monte_carlo(loop(), 4, **mission)
    assert plain.compiled_loop is not None and not any(plain.compiled_loop.libraries)
    assert quick.states.tobytes() == plain.states.tobytes()


@needs_compiler
def test_a_step_that_fails_is_reported_as_by_the_interpreter() -> None:
    x, w, c = (ca.MX.sym(name) for name in "xwc")
    step = ca.Function("only", [x, w, c], [(x - w).attachAssert(x > c, "too low")])
    fly = module.load_control_step_library(module.build_control_step_library(step))
    final = np.empty(1)
    assert fly is not None
    fly(np.array([5.0]), np.array([[1.0], [2.0]]), np.array([3.0]), final)
    assert final == [2.0]
    with pytest.raises(GncOptError, match="could not be evaluated"):
        fly(np.array([5.0]), np.array([[1.0], [2.0], [0.0]]), np.array([3.0]), final)
