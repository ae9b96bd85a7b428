"""Linearization tables: equal to the linearization itself, smooth or not."""

import casadi as ca
import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.control import ErrorDynamics, Reference
from gnc_opt.control.tvlqr_gains import LinearizationTable


def pendulum() -> go.Model:
    model = go.Model("pendulum")
    q, v = model.state("q"), model.state("v")
    a = model.control("a")
    model.ode({q: v, v: a * ca.cos(q) - ca.sin(q)})
    return model


def path(angle, jumps=()) -> Reference:
    return Reference.from_functions(
        pendulum(), lambda t: [angle(t), 0.0], lambda t: [1.0 if t < 1.3 else -1.0], 0.0, 4.0, jumps=jumps
    )


@pytest.mark.parametrize(
    "reference",
    [
        path(np.cos, jumps=[1.3]),
        path(lambda t: np.cos(40 * t), jumps=[1.3]),  # too fast for one interpolant: halved
        path(lambda t: abs(t - 2.1)),  # a kink and a jump that nobody declared: the function itself
    ],
)
def test_table_equals_the_linearization(reference):
    deviation = ErrorDynamics(reference.model)
    table = LinearizationTable(deviation, reference)
    for t in np.concatenate([np.linspace(0.0, 4.0, 201), [1.3]]):
        wanted = deviation.linearize(t, reference.x(t), reference.u(t))
        for found, exact in zip(table(t), wanted, strict=True):
            np.testing.assert_allclose(found, exact, atol=1e-12)


def test_reference_without_duration():
    reference = Reference.constant(pendulum(), [0.0, 0.0])
    table = LinearizationTable(ErrorDynamics(reference.model), reference)
    np.testing.assert_allclose(table(0.0)[0], [[0, 1], [-1, 0]], atol=1e-15)
