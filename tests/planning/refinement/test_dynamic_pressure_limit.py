"""An ascent with a limit on dynamic pressure, which throttle and pitch can hold together.

Throttled, the launcher follows the limit until its throttle is at its end again. There pitch goes on to hold the limit
for a few milliseconds, in which the costate of the limit is handed back; then it is left. The throttle along the limit
has a closed form.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from testing.models import one_phase

import gnc_opt as go

G0, THRUST, EXHAUST, AREA, HEIGHT = 9.80665, 2.1e6, 310 * 9.80665, 2.8, 7600.0
MOST = 25e3


def ascent(most: float) -> go.Problem:
    model = go.Model("launcher")
    h, vx, vz, m = (model.state(name) for name in ("h", "vx", "vz", "m"))
    throttle, pitch = model.control("throttle"), model.control("pitch")
    density, squared = 1.225 * ca.exp(-h / HEIGHT), vx**2 + vz**2
    drag = 0.5 * density * ca.sqrt(squared + 1.0) * AREA
    thrust = throttle * THRUST
    model.ode(
        {
            h: vz,
            vx: (thrust * ca.cos(pitch) - drag * vx) / m,
            vz: (thrust * ca.sin(pitch) - drag * vz) / m - G0,
            m: -thrust / EXHAUST,
        }
    )
    problem, leg = one_phase("ascent", model, initial=0.0, final=(100.0, 500.0), name="ascent")
    leg.initial(h=100.0, vx=1.0, vz=20.0, m=120e3)
    leg.final(h=180e3, vx=5000.0, vz=0.0)
    leg.bounds(throttle=(0.1, 1.0), pitch=(-0.5, 1.6))
    leg.bounds(h=(0.0, 400e3), vx=(0.0, 9e3), vz=(-500.0, 4e3), m=(5e3, 120e3))
    leg.path("q", 0.5 * density * squared, upper=most)
    problem.maximize(leg.final_state("m"))
    return problem


@pytest.fixture(scope="module")
def flown() -> go.Solution:
    return go.solve(ascent(MOST))


@pytest.mark.slow
def test_the_limit_is_held_by_throttle_and_then_for_a_moment_by_pitch(flown: go.Solution) -> None:
    assert go.verify(flown).minimum
    arcs = [(a.kind.value, a.start, a.end) for a in flown.structure if a.channel == "throttle"]
    assert [kind for kind, *_ in arcs] == ["upper", "constrained", "upper", "lower"]
    (held,) = (a for a in flown.structure if a.channel == "q")
    start, bound = arcs[1][1:]
    assert held.start == pytest.approx(start, abs=1e-9)
    assert 0.0 < held.end - bound < 0.01

    leg = flown.phases["ascent"]
    times = np.linspace(start + 0.1, bound - 1e-6, 20)
    h, vx, vz, m = leg.x(times)
    throttle, pitch = leg.u(times)
    speed = np.hypot(vx, vz)
    assert 0.6125 * np.exp(-h / HEIGHT) * speed**2 == pytest.approx(np.full(20, MOST), rel=1e-8)
    needed = m * speed**2 * vz / (2 * HEIGHT) + m * G0 * vz  # of v . dv/dt, where dq/dt = 0
    needed += 0.6125 * np.exp(-h / HEIGHT) * np.sqrt(speed**2 + 1.0) * AREA * speed**2
    assert throttle * THRUST * (vx * np.cos(pitch) + vz * np.sin(pitch)) == pytest.approx(needed, rel=1e-6)
    assert throttle[-1] == pytest.approx(1.0, abs=1e-6), "it comes to its bound without a jump"
