"""The problem files: reference values, closed forms along the trajectory, structures, the shared ``main``."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import gnc_opt as go
from gnc_opt import cli
from gnc_opt.problem_files_and_examples import find_example, list_examples
from problems._example import TOLERANCE, Reference, run
from problems.ascent import delta3, goddard
from problems.attitude import bilimoria_wie
from problems.classics import bryson_denham, cannonball, minimum_fuel, van_der_pol, zermelo
from problems.entry import shuttle
from problems.landing import mars_landing, moon_landing
from problems.low_thrust import earth_mars
from problems.robots import robot_arm

Array = NDArray[np.float64]

ROOT = Path(__file__).parents[2]
NAMES = [each.name for each in list_examples() if not each.is_package]
"""The basic problems, of one file each; systems are folders with tests of their own."""
COARSE = {
    # Deviation from the reference on 10x3, in shares of it: what such a mesh is worth, no more.
    "mars_landing": 1e-4,
    "earth_mars": 2e-5,
    "cw_thrust": 5e-3,
    "quadrotor": 3e-4,
    "reorientation": 2e-2,
    "tumour": 1e-4,
    "cannonball": 1e-6,
}
"""Solved once on a coarse mesh."""
REFINED = (
    *("bilimoria_wie", "brachistochrone", "bryson_denham", "cw_fuel", "goddard", "hang_glider"),
    *("interior_point", "minimum_fuel", "moon_landing", "orbit_raising", "periodic", "robot_arm", "shuttle"),
    *("speed_limit", "van_der_pol", "zermelo"),
)
"""One or more of every trade, solved as their ``main`` does; ``python -m benchmarks.validation.engine`` solves all."""
CLOSED = {
    # Tolerances of states, controls and costates: the accuracy asked for, larger where a cost is flat
    # (control errors of 1e-6 change it by 1e-12), next to nothing where switch times were optimised.
    "brachistochrone": (1e-8, 1e-6, 1e-7),
    "zermelo": (1e-7, 1e-6, 1e-7),
    "minimum_fuel": (1e-9, 1e-9, 1e-8),
    "speed_limit": (1e-8, 1e-8, 1e-7),
    "bryson_denham": (1e-9, 1e-8, 1e-5),
    "moon_landing": (1e-8, 1e-8, 1e-8),
    "interior_point": (1e-6, 1e-5, 1e-5),
    "periodic": (1e-7, 1e-6, 1e-6),
}


@cache
def solved(name: str) -> go.Solution:
    """The solution of a problem file at default settings, as its ``main`` gets it."""
    return go.solve(module(name).build(), tol=TOLERANCE)


def module(name: str) -> ModuleType:
    return find_example(name).module


def inner_times(leg: go.PhaseSolution, number: int = 61) -> Array:
    """Times strictly inside a phase and its segments: at a seam costates and controls have two values."""
    times = np.linspace(leg.initial_time, leg.final_time, number)[1:-1]
    return times[np.min(np.abs(times[:, None] - leg.breaks), axis=1) > 1e-9 * leg.duration]


def test_every_file_states_its_reference_and_every_trade_is_solved() -> None:
    known = {name for name in NAMES if hasattr(module(name), "closed_form")}
    assert set(CLOSED) == known - {"hypersensitive"}, "ten thousand time constants take seconds"
    assert {find_example(name).path.parent for name in REFINED} == {
        find_example(name).path.parent for name in NAMES
    }
    for name in NAMES:
        reference = module(name).REFERENCE
        assert reference.source
        assert 0 < reference.tolerance < 3e-3 * max(1.0, abs(reference.value)), name


@pytest.mark.parametrize("name", REFINED)
def test_reference_at_default_settings(name: str) -> None:
    solution, reference = solved(name), module(name).REFERENCE
    assert solution.status is go.Status.OPTIMAL
    assert solution.history is not None
    assert solution.history.status is go.RefinementStatus.CONVERGED
    assert solution.objective == pytest.approx(reference.value, rel=0, abs=reference.tolerance)
    assert reference.tolerance <= 1e-6 * max(1.0, abs(reference.value))


@cache
def roughly(name: str) -> go.Solution:
    """The solution of a problem file on a coarse mesh."""
    return go.solve(module(name).build(), mesh="10x3", tol=None)


@pytest.mark.parametrize("name", COARSE)
def test_reference_roughly(name: str) -> None:
    reference = module(name).REFERENCE
    assert roughly(name).objective == pytest.approx(reference.value, rel=COARSE[name])


@pytest.mark.parametrize("name", ["mars_landing", "earth_mars", "cw_thrust"])
def test_thrust_keeps_its_norm_and_burns_the_fuel(name: str) -> None:
    """The integral of the norm of the vector, as flown and reported, is what the cost says."""
    solution = roughly(name)
    leg = solution.phase()
    label = "a" if name == "cw_thrust" else "T"
    vector = np.asarray(leg.control(label)(leg.point_times))
    norm = np.linalg.norm(vector, axis=0)
    row = leg.controls.slice(f"{label}_magnitude")
    limits = [bound[row][0] for bound in (leg.control_bounds.lower, leg.control_bounds.upper)]
    assert np.all((norm >= limits[0] * (1 - 1e-6)) & (norm <= limits[1] * (1 + 1e-6)))
    weights = np.concatenate(
        [
            rule.weights * width / 2
            for rule, width in zip(leg.collocation_rules, np.diff(leg.breaks), strict=True)
        ]
    )
    burnt = norm @ weights
    wanted = {
        "mars_landing": lambda: (1905.0 - solution.objective) / mars_landing.MASS_RATE,
        "earth_mars": lambda: (1000.0 - solution.objective) * earth_mars.EXHAUST_SPEED,
        "cw_thrust": lambda: solution.objective,
    }[name]()
    assert burnt == pytest.approx(wanted, rel=1e-5)


def test_range_of_the_cannonball_by_integration() -> None:
    """The shot that is found flies as far by another program, and shots next to it less far."""
    solution = roughly("cannonball")
    radius, angle = float(solution.parameter("radius")), float(solution.state("gamma", "ascent")(0.0))

    def flown(radius: float, angle: float) -> float:
        mass = cannonball.mass_of(radius)

        def rates(_: float, y: Array) -> list[float]:
            drag = 0.5 * 1.225 * (1 - 2.25577e-5 * y[1]) ** 4.2558797 * y[2] ** 2 * 0.5 * np.pi * radius**2
            along, across = np.cos(y[3]), np.sin(y[3])
            return [y[2] * along, y[2] * across, -drag / mass - 9.80665 * across, -9.80665 * along / y[2]]

        def ground(_: float, y: Array) -> float:
            return float(y[1])

        ground.terminal, ground.direction = True, -1  # type: ignore[attr-defined]
        start = [0.0, 0.0, math.sqrt(2 * cannonball.ENERGY / mass), angle]
        run = solve_ivp(rates, (0.0, 100.0), start, "DOP853", rtol=1e-11, atol=1e-9, events=ground)
        return float(run.y[0, -1])

    best = flown(radius, angle)
    assert best == pytest.approx(cannonball.REFERENCE.value, abs=1e-3)
    for change in (0.02, -0.02):
        assert flown(radius * (1 + change), angle) < best - 0.1
        assert flown(radius, angle * (1 + change)) < best - 0.1


@pytest.mark.parametrize("name", REFINED)
def test_verdict_fails_nowhere_without_an_explanation(name: str) -> None:
    verdict = go.verify(solved(name))
    assert {condition.name for condition in verdict.failed} <= set(getattr(module(name), "EXPLAINED", {}))


@pytest.mark.parametrize("name", CLOSED)
def test_trajectory_and_costates_are_the_closed_form(name: str) -> None:
    solution, tolerances = solved(name), CLOSED[name]
    for leg in solution.phases.values():
        t = inner_times(leg)
        if name == "bryson_denham":  # at entry and exit lam_x jumps and the control has a kink
            edge = 3 * bryson_denham.LIMIT
            t = t[np.minimum(np.abs(t - edge), np.abs(t - 1 + edge)) > 1e-6]
        wanted = module(name).closed_form(t)
        found = (leg.state, leg.control, leg.costate)
        kinds = (wanted.states, wanted.controls, wanted.costates)
        for values, signal, tolerance in zip(kinds, found, tolerances, strict=True):
            assert values
            for variable, value in values.items():
                np.testing.assert_allclose(signal(variable)(t), value, rtol=0, atol=tolerance)


@pytest.mark.parametrize("name", [n for n in CLOSED if n != "bryson_denham"])
def test_closed_form_satisfies_the_dynamics(name: str) -> None:
    """The closed forms are judged too: differences of the states over 2e-6 s are the rates of the model."""
    problem = module(name).build()
    for key, leg in problem.phases.items():
        span = solved(name).phases[key]
        t = inner_times(span, 23)
        at, before, after = (module(name).closed_form(t + step) for step in (0.0, -1e-6, 1e-6))
        x = np.stack([at.states[label] for label in leg.model.states.names])
        u = np.stack([at.controls[label] for label in leg.model.controls.names])
        slope = np.stack(
            [(after.states[label] - before.states[label]) / 2e-6 for label in leg.model.states.names]
        )
        rates = np.stack([leg.model.f(t[i], x[:, i], u[:, i]) for i in range(t.size)], axis=1)
        np.testing.assert_allclose(slope, rates, rtol=0, atol=1e-7)


def test_zermelos_boat_has_the_published_headings_and_steers_by_its_costates() -> None:
    np.testing.assert_allclose(np.degrees(zermelo.headings()), (105.0, 240.0), atol=0.1)
    leg = solved("zermelo").phase()
    t = inner_times(leg)
    theta = leg.control("theta")(t)
    cross = leg.costate("x")(t) * np.sin(theta) - leg.costate("y")(t) * np.cos(theta)
    np.testing.assert_allclose(cross, 0.0, atol=1e-6)


def switches(name: str, channel: str) -> tuple[float, ...]:
    return tuple(arc.start for arc in solved(name).structure if arc.channel == channel and arc.start > 0)


def test_switch_times_of_the_robot_arm() -> None:
    for channel, times in robot_arm.SWITCH_TIMES.items():
        assert switches("robot_arm", channel) == pytest.approx(times, abs=1e-7)


def test_reorientation_is_faster_than_the_turn_about_one_axis() -> None:
    times = sorted(t for i in range(3) for t in switches("bilimoria_wie", f"torque[{i}]"))
    assert times == pytest.approx(bilimoria_wie.SWITCH_TIMES, abs=1e-7)
    solution = solved("bilimoria_wie")
    assert solution.objective / bilimoria_wie.EIGENAXIS_TIME == pytest.approx(1 - 0.085, abs=5e-4)
    t = inner_times(solution.phase())
    np.testing.assert_allclose(np.linalg.norm(solution.state("q")(t), axis=0), 1.0, atol=1e-8)


def test_singular_arc_of_van_der_pol_follows_its_feedback_law() -> None:
    leg = solved("van_der_pol").phase()
    first, entry = switches("van_der_pol", "u")
    assert (first, entry) == pytest.approx(van_der_pol.SWITCH_TIMES, abs=1e-8)
    t = np.linspace(van_der_pol.SWITCH_TIMES[1] + 0.01, leg.final_time - 0.01, 40)
    law = van_der_pol.singular_control(leg.state("x")(t), leg.state("y")(t))
    np.testing.assert_allclose(leg.control("u")(t), law, atol=1e-4)
    np.testing.assert_allclose(leg.costate("y")(t), 0.0, atol=1e-6)
    np.testing.assert_allclose(leg.costate("x")(t), -leg.state("y")(t), atol=1e-5)


def goddard_switches() -> tuple[float, float]:
    """Full thrust up to the surface, thrust that keeps to it, burn-out: by integration, without any optimisation."""
    c, g = goddard.EXHAUST_SPEED, goddard.GRAVITY
    x, thrust = ca.SX.sym("x", 3), ca.SX.sym("thrust")
    force = goddard.drag(x[0], x[1])
    rate = ca.vertcat(x[1], (thrust - force) / x[2] - g, -thrust / c)
    surface = (1 + x[1] / c) * force - x[2] * g
    drift = ca.jtimes(surface, x, rate)  # affine in thrust
    gain = ca.jacobian(drift, thrust)
    keeping = -ca.substitute(drift, thrust, 0) / gain
    full = ca.Function("full", [x], [ca.substitute(rate, thrust, goddard.MAX_THRUST), surface])
    held = ca.Function("held", [x], [ca.substitute(rate, thrust, keeping)])

    def until(flow: Callable[[Array], Array], event: Callable[[Array], float], start: float, x: Any) -> Any:
        def stop(_: float, y: Array) -> float:
            return event(y)

        stop.terminal = True  # type: ignore[attr-defined]
        run = solve_ivp(
            lambda _, y: flow(y), (start, start + 40.0), x, "DOP853", rtol=1e-13, atol=1e-10, events=stop
        )
        return run.t[-1], run.y[:, -1]

    begin = [0.0, 0.0, goddard.FULL]
    first, x_first = until(lambda y: full(y)[0].full()[:, 0], lambda y: float(full(y)[1]), 0.0, begin)
    last, _ = until(lambda y: held(y).full()[:, 0], lambda y: y[2] - goddard.EMPTY, first, x_first)
    return float(first), float(last)


def test_goddards_singular_arc_lies_on_its_surface() -> None:
    leg = solved("goddard").phase()
    first, last = switches("goddard", "thrust")
    assert (first, last) == pytest.approx(goddard_switches(), rel=1e-8)
    inside = np.linspace(first, last, 42)[1:-1]
    outside = np.array([first - 2.0, last + 2.0])
    on, off = (
        goddard.singular_surface(*(leg.state(name)(t) for name in ("h", "v", "m"))) for t in (inside, outside)
    )
    np.testing.assert_allclose(on, 0.0, atol=1e-4)
    assert np.all(np.abs(off) > 0.05)


FOOT, SLUG = goddard.FOOT, goddard.SLUG
INITIAL_COSTATES: dict[str, dict[str, Any]] = {
    # Derivatives of the objective as stated with respect to the initial state.
    "van_der_pol": {"x": -0.495293564, "y": 2.588365502},
    "robot_arm": {
        "rho": 1.200071173,
        "rho_rate": 1.837410893,
        "theta": -1.368581093,
        "theta_rate": -6.255039492,
        "phi": 3.482556413,
        "phi_rate": 6.729004748,
    },
    "orbit_raising": {"r": 1.877335986, "v_r": 0.928933659, "v_t": 2.025156223},
    "hang_glider": {"x": 1.019342001, "y": 10.273834801, "v_x": 14.053757394},
    "shuttle": {
        "h": 0.0080327396 / (1e5 * FOOT),
        "latitude": 0.253500032,
        "v": 0.7412965136 / (1e4 * FOOT),
        "gamma": 0.270618578,
        "psi": -0.967335377,
    },
    # By central differences of simulations, to 1e-6 or so.
    "goddard": {"h": 1.2396511, "v": 29.4086592, "m": 7748.89999 * FOOT / SLUG},
}


@pytest.mark.parametrize("name", INITIAL_COSTATES)
def test_initial_costates(name: str) -> None:
    solution = solved(name)
    leg = next(iter(solution.phases.values()))
    sign = -1.0 if solution.maximised else 1.0
    for state, wanted in INITIAL_COSTATES[name].items():
        found = sign * np.asarray(leg.costate(state)(leg.initial_time))
        np.testing.assert_allclose(found, wanted, rtol=2e-4 if name == "goddard" else 1e-5)


def test_initial_costate_of_the_reorientation() -> None:
    """H = -1 at rest: the costates of the rates add up to 1; axes 1 and 2 are mirror images."""
    leg = solved("bilimoria_wie").phase()
    lam = np.abs(leg.costate("omega")(0.0))
    assert np.sum(lam) == pytest.approx(1.0, abs=1e-8)
    assert sorted(lam[:2]) == pytest.approx((0.0760048229, 0.2303298292), abs=1e-6)


def test_delta3_drops_what_it_should_and_reaches_its_orbit() -> None:
    """On a coarse mesh: the drops and the orbit are constraints."""
    legs = list(go.solve(delta3.build(), mesh="4x3", tol=None).phases.values())
    for first, second, data in zip(legs, legs[1:], delta3.LEGS[1:], strict=False):
        drop = first.state("m")(first.final_time) - second.state("m")(second.initial_time)
        assert drop == pytest.approx(data.dropped, abs=1e-3)
    r, v = (np.asarray(legs[-1].state(name)(legs[-1].final_time)) for name in ("r", "v"))
    semi_major = 1 / (2 / np.linalg.norm(r) - v @ v / delta3.MU)
    h = np.cross(r, v)
    eccentricity = np.linalg.norm(np.cross(v, h) / delta3.MU - r / np.linalg.norm(r))
    assert semi_major == pytest.approx(24361140.0, rel=1e-7)
    assert eccentricity == pytest.approx(0.7308, abs=1e-7)
    assert np.degrees(np.arccos(h[2] / np.linalg.norm(h))) == pytest.approx(28.5, abs=1e-6)


def test_shuttle_reaches_the_published_latitude_in_the_published_time() -> None:
    solution = solved("shuttle")
    assert math.degrees(solution.objective) == pytest.approx(34.1412, abs=1e-4)
    assert solution.phase().final_time == pytest.approx(2008.59, abs=0.01)
    assert solution.state("v")(solution.phase().final_time) == pytest.approx(2500 * shuttle.FOOT)


@pytest.mark.usefixtures("blank_figures")
def test_main_writes_what_it_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, folder = tmp_path / "out.json", tmp_path / "report"
    assert moon_landing.main(["--json", str(out), "--report", str(folder)]) == 0
    told = json.loads(out.read_text(encoding="utf-8"))
    assert told["verdict"]["ok"]
    assert told["reference"]["agrees"]
    assert told["reference"]["value"] == pytest.approx(2 * math.sqrt(17), rel=1e-15)
    assert {"report.html", "states.svg"} <= {path.name for path in folder.iterdir()}
    printed = capsys.readouterr().out
    assert "pass" in printed.splitlines()[-2]
    assert "soft landing on the Moon" in printed


def test_main_fails_where_the_reference_is_missed(capsys: pytest.CaptureFixture[str]) -> None:
    wrong = Reference(8.2463, "misprint", 1e-6, "m/s")
    assert run(moon_landing.build, wrong, []) == 1
    assert "FAIL" in capsys.readouterr().out.splitlines()[-1]


def test_main_fails_where_a_problem_cannot_be_solved(capsys: pytest.CaptureFixture[str]) -> None:
    def build() -> go.Problem:
        return minimum_fuel.build(duration=1.5)  # less than the least time, 2 s

    assert run(build, minimum_fuel.REFERENCE, []) == 1
    assert "minimum fuel" in capsys.readouterr().err


def test_problem_files_work_with_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    for name in NAMES[::4]:
        assert cli.main(["check", str(find_example(name).path)]) == 0
    assert capsys.readouterr().out.count("no error in the statement") == len(NAMES[::4])
    file = str(find_example("minimum_fuel").path)
    assert cli.main(["solve", file, "--tol", "1e-8", "--set", "duration=2.5", "--quiet"]) == 0


@pytest.mark.parametrize("name", [*NAMES])
def test_the_index_lists_every_file(name: str) -> None:
    index = (ROOT / "docs" / "problems.md").read_text(encoding="utf-8")
    row = next(line for line in index.splitlines() if line.startswith(f"| [![{name}](pictures/"))
    value = module(name).REFERENCE.value
    shown = row.rsplit("|", 4)[1].split()[0]
    digits = len(shown.replace(".", "").lstrip("0"))
    assert float(shown) == pytest.approx(value, rel=10.0 ** (1 - digits))
