"""Counting steps: rounding neither adds nor drops one."""

import casadi as ca
import pytest
from testing.internals import (
    advance_step_counter,
    count_steps_in_duration,
    count_steps_started_within_duration,
    is_step_counter_zero,
)

from gnc_opt.errors import ArgumentError


@pytest.mark.parametrize(
    ("duration", "step", "count"),
    [
        (0.14, 0.02, 7), (1.12, 0.02, 56), (0.7, 0.1, 7), (0.3, 0.1, 3), (0.0, 0.1, 0), (1.15, 0.1, 12),
        (0.01, 0.1, 1),
    ],
)  # fmt: skip
def test_steps_that_begin_within_a_duration(duration, step, count):
    assert count_steps_started_within_duration(duration, step) == count


def test_a_duration_must_be_whole_steps():
    assert [count_steps_in_duration(n * 0.1, 0.1, "it") for n in range(50)] == list(range(50))
    for duration in (0.15, 0.1001, -0.1):
        with pytest.raises(ArgumentError, match=r"it is .* not a multiple of the step of 0\.1 s"):
            count_steps_in_duration(duration, 0.1, "it")


@pytest.mark.parametrize("count", [1, 2, 5])
def test_phases_begin_anew(count):
    phase = ca.SX.sym("phase")
    function = ca.Function("f", [phase], [is_step_counter_zero(phase), advance_step_counter(phase, count)])
    at, seen = 0.0, []
    for _ in range(3 * count):
        first, after = (float(value) for value in function(at))
        assert first == (at == 0)
        seen.append(int(at))
        at = after
    assert seen == list(range(count)) * 3
