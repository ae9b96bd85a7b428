"""Long runs: simulated in segments with the same bits, logged every so often."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from testing.loops import double_integrator

import gnc_opt as go
from gnc_opt.control import design_lqr
from gnc_opt.errors import ArgumentError
from gnc_opt.simulation import ClosedLoop, Lag, Noise, PiecewiseConstantNoise
from gnc_opt.simulation import compiled_closed_loop as flight_module

ARRAYS = ("times", "states", "measured", "commands", "applied", "memory", "errors", "reference")


def loop() -> ClosedLoop:
    plant = double_integrator()
    regulator = design_lqr(plant, [0, 0], Q=1, R=1, dt=0.1, integral={"q": 0.1})
    return ClosedLoop(
        plant, regulator, [Lag("lag", 0.2)], [Noise("gauge", 1e-3, on="q")],
        [PiecewiseConstantNoise("gust", 0.1, 0.7, on="a")],
    )  # fmt: skip


def fly(**options) -> go.simulation.Run:
    return loop().simulate([1.0, 0.0], tf=23.7, seed=5, **options)


@pytest.fixture(scope="module")
def whole():
    return fly()


@pytest.mark.parametrize("n_steps", [1, 236, 237])
def test_the_number_of_steps_per_call_changes_no_bit(monkeypatch, whole, n_steps):
    monkeypatch.setattr(flight_module, "MAX_STEPS_PER_CALL", n_steps)
    run = fly()
    assert all(np.array_equal(getattr(run, name), getattr(whole, name)) for name in ARRAYS)
    assert np.array_equal(run.effort, whole.effort) and run.integration_error == whole.integration_error
    flight = loop().compile([1.0, 0.0], tf=23.7)
    assert "step_sequence_functions" not in vars(pickle.loads(pickle.dumps(flight.kernel)))
    ending = flight.final_values(np.tile(flight.nominal[:, None], 2), [5, 6])
    assert np.array_equal(ending.states[:, 0], whole.states[:, -1])
    assert np.array_equal(ending.states[:, 1], loop().simulate([1.0, 0.0], tf=23.7, seed=6).states[:, -1])


def test_what_is_no_number_of_steps_is_refused():
    with pytest.raises(ArgumentError, match="control steps of which one is logged"):
        fly(every=0)


GROWTH = """
import resource
from test_long_runs import loop
peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
loop().simulate([1.0, 0.0], tf=200.0, every=100)
before = peak()
loop().simulate([1.0, 0.0], tf=1200.0, every=100)
print(peak() - before)
"""


def test_memory_grows_by_less_than_a_kilobyte_per_step():
    """What is known beforehand (times, references) takes some hundred bytes per step; a day has 864 000 of them."""
    pytest.importorskip("resource")
    here = Path(__file__).parent
    paths = os.pathsep.join([str(here.parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])])
    found = subprocess.run(
        [sys.executable, "-c", GROWTH], cwd=here, env={**os.environ, "PYTHONPATH": paths},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert float(found.stdout) < 0.5e-3 * 12_000
