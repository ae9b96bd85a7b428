"""Figures of runs show what was logged."""

import numpy as np
import pytest
from testing.loops import double_integrator, scheduled

from gnc_opt.control import Reference, feedforward
from gnc_opt.errors import ArgumentError, UnknownNameError
from gnc_opt.plot import plot_run
from gnc_opt.simulation import ClosedLoop, Lag


@pytest.fixture(scope="module")
def run():
    plant = double_integrator()
    reference = Reference.from_functions(plant, lambda t: [t**2 / 2, t], lambda t: [1.0], 0.0, 2.0)
    return ClosedLoop(plant, feedforward(reference), [Lag("lag", 0.1)], dt=0.1).simulate([0.0, 0.0], tf=2.0)


def test_states_with_reference_and_units(run):
    axes = plot_run(run).axes
    assert [ax.get_ylabel() for ax in axes] == ["$q$ (m)", "$v$ (m/s)"]
    followed, flown = axes[0].get_lines()
    assert np.array_equal(flown.get_ydata(), run.states[0])
    assert followed.get_ydata() == pytest.approx(run.times**2 / 2)
    assert axes[-1].get_xlabel() == "time (s)"


def test_controls_show_command_and_what_was_applied(run):
    (ax,) = plot_run(run, "controls").axes
    command, applied = ax.get_lines()
    assert command.get_ydata() == pytest.approx(1.0)
    assert np.array_equal(applied.get_ydata(), run.applied[0])
    assert applied.get_drawstyle() == "steps-post"


def test_errors(run):
    axes = plot_run(run, "errors", ["v"]).axes
    assert axes[0].get_lines()[0].get_ydata() == pytest.approx(run.states[1] - run.times)


def test_what_is_not_there_is_refused(run):
    with pytest.raises(UnknownNameError, match="no state 'vv'"):
        plot_run(run, "states", ["vv"])
    plant = double_integrator()
    free = ClosedLoop(plant, scheduled(plant, lambda t: 0 * t), dt=0.1).simulate([0.0, 0.0], tf=1.0)
    with pytest.raises(ArgumentError, match="has no reference"):
        plot_run(free, "errors")
