"""Flight code of predictive control: its own solver, of fixed memory, finds what that of the simulations finds."""

import re
import subprocess

import numpy as np
import pytest
from testing.c_compiler import COMPILER, FLAGS, compiled, needs_compiler, sanitized
from testing.mpc_designs import DT, A, B, cart, pendulum, tracker

import gnc_opt as go
from gnc_opt.errors import ArgumentError
from gnc_opt.estimation import Measurement

DRIVER = """
#include <stdio.h>
#include "law.h"
int main(void)
{
    double t, x[LAW_N_STATES], z[LAW_N_MEMORY], u[LAW_N_COMMANDS];
    int i, begun = 0;
    while (scanf("%lf", &t) == 1) {
        for (i = 0; i < LAW_N_STATES; ++i)
            if (scanf("%lf", &x[i]) != 1)
                return 1;
        if (!begun)
            law_start(t, x, z);
        begun = 1;
        law_step(t, x, z, u);
        for (i = 0; i < LAW_N_COMMANDS; ++i)
            printf("%.17g ", u[i]);
        for (i = 0; i < LAW_N_MEMORY; ++i)
            printf("%.17g ", z[i]);
        printf("\\n");
    }
    return 0;
}
"""


def quickly_compiled(code):
    return compiled(code, "-O0")


def flown_in_c(controller, folder, times, states, build=quickly_compiled):
    """Commands (n, n_commands) and alarms (n, n_alarms) of the law compiled."""
    code = go.export_c(controller, folder, name="law")
    code.driver.write_text(DRIVER)
    program = build(code)
    lines = [" ".join(repr(float(v)) for v in (t, *x)) for t, x in zip(times, states, strict=True)]
    found = subprocess.run([str(program)], input="\n".join(lines), check=True, capture_output=True, text=True)
    numbers = np.array([[float(v) for v in line.split()] for line in found.stdout.splitlines()])
    m, memory = controller.commands.size, controller.codegen_law.controller.memory
    alarms = [m + memory.slice(alarm).start for alarm in controller.alarms]
    return numbers[:, :m], numbers[:, alarms]


def flown(controller, x, steps):
    """Times, states, commands and alarms of the cart in closed loop with the law in Python."""
    z, states, commands, alarms = None, [], [], []
    for k in range(steps):
        states.append(x)
        u, z = controller(k * DT, x, z)
        x = A @ x + B * u[0]
        commands.append(u)
        alarms.append([z[controller.memory.slice(a)][0] for a in controller.alarms])
    return DT * np.arange(steps), np.array(states), np.array(commands), np.array(alarms)


@needs_compiler
@pytest.mark.parametrize(
    ("options", "start"),
    [
        ({"rate_limits": 5.0, "state_limits": {"v": (-0.5, np.inf)}}, [3.0, 0.0]),  # soft, met and kept
        ({"state_limits": {"v": (-0.5, 0.5)}}, [0.0, 2.0]),  # soft, left
        ({"state_limits": {"v": (-0.5, 0.5)}, "hard": ["v"]}, [0.0, 0.9]),  # no solution at first
    ],
)
def test_commands_and_alarms_of_a_closed_loop_are_those_of_python(tmp_path, options, start):
    controller = tracker(**options)
    times, states, commands, alarms = flown(controller, np.array(start), 40)
    found, told = flown_in_c(controller, tmp_path, times, states)
    assert np.ptp(commands) > 0.5
    assert np.allclose(found, commands, atol=1e-8)
    assert np.array_equal(told, alarms)
    # 0.4 m/s too fast at the first step, 0.1 m/s a step can be had.
    assert alarms[0, 0] == (start == [0.0, 0.9])


@needs_compiler
def test_along_a_reference_the_matrices_are_those_of_each_step(tmp_path):
    model, reference = pendulum()
    limits = {"limits": (-0.3, 0.3), "state_limits": {"v": (-0.9, 0.9)}, "rate_limits": 2.0}
    controller = go.design_mpc(model, reference, Q=1, R=0.1, horizon=0.8, dt=DT, **limits)
    times = DT * np.arange(45)  # beyond the end
    states = reference.x(times).T + np.random.default_rng(3).normal(size=(45, 2)) * [0.3, 0.2]
    z, commands = None, []
    for t, x in zip(times, states, strict=True):
        u, z = controller(t, x, z)
        commands.append(u)
    found, told = flown_in_c(controller, tmp_path, times, states, sanitized)
    assert np.mean(np.abs(np.array(commands)) > 0.2999) > 0.2
    assert np.allclose(found, commands, atol=1e-8)
    assert not np.any(told)


@needs_compiler
def test_header_bounds_what_the_compiler_needs(tmp_path):
    """The arrays of the deepest chain of calls, from what the compiler says of its frames."""
    controller = tracker(horizon=1.0, rate_limits=5.0, state_limits={"v": (-0.5, 0.5)})
    code = go.export_c(controller, tmp_path, name="law")
    told = int(re.search(r"LAW_STACK (\d+)", code.header.read_text())[1])
    assert not re.search(r"\b(?:m|c|re)alloc\b|stdlib", code.source.read_text() + code.header.read_text())
    command = [COMPILER, *FLAGS, "-O0", "-fstack-usage", "-c", str(code.source), "-o", "law.o"]
    if subprocess.run(command, cwd=tmp_path, capture_output=True).returncode:
        pytest.skip("the compiler does not tell its frames")
    lines = next(tmp_path.glob("*.su")).read_text().splitlines()
    frames = {line.split("\t")[0].rsplit(":", 1)[1]: int(line.split("\t")[1]) for line in lines}
    chain = ("law_step", "step", "programme", "least", "add_row", "rows_of")
    # Single numbers are no arrays.
    assert told <= sum(frames[name] for name in chain) < told + 200 * len(chain)


def test_worst_case_grows_with_the_horizon_and_the_limits(tmp_path):
    def operations(**options):
        header = go.export_c(tracker(**options), tmp_path, name="law").header.read_text()
        return int(re.search(r"LAW_OPERATIONS (\d+)", header)[1])

    short, long = operations(horizon=0.5), operations(horizon=1.0)
    # Iterations in proportion to the unknowns, each of their square at most.
    assert 4 * short < long < 16 * short
    assert operations(horizon=0.5, rate_limits=5.0) > short


def test_refusals(tmp_path):
    model, reference = pendulum()
    given = {"Q": 1, "R": 1, "horizon": 0.2, "dt": DT, "limits": (-9, 9)}
    controller = go.design_mpc(model, reference, **given)
    with pytest.raises(ArgumentError, match="'MPC' knows the span of its schedule"):
        go.export_c(controller, tmp_path, span=(0.0, 1.0))
    assert go.export_c(controller, tmp_path).rows == 31
    assert (
        go.export_c(go.design_mpc(cart(), go.Reference.constant(cart(), [0, 0]), **given), tmp_path).rows == 1
    )


@needs_compiler
def test_behind_an_estimator_it_is_the_same_law(tmp_path):
    controller = tracker(rate_limits=5.0)
    told = {"sigma0": {"q": 0.1, "v": 0.5}, "process_noise": {"v": 0.1}, "dt": DT}
    estimator = go.design_ekf(cart(), [3.0, 0.0], [Measurement("q", 0.05)], **told)
    fed = go.output_feedback(controller, estimator)
    times, states, _, _ = flown(controller, np.array([3.0, 0.0]), 15)
    z, commands = None, []
    for t, x in zip(times, states, strict=True):
        u, z = fed(t, x[:1], z)
        commands.append(u)
    found, _ = flown_in_c(fed, tmp_path, times, states[:, :1])
    assert np.ptp(commands) > 0.5
    assert np.allclose(found, commands, atol=1e-8)
