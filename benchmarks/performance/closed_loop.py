"""Speed: a campaign of the followed rendezvous against a straightforward Python loop over scipy's solve_ivp.

    python -m benchmarks.performance.closed_loop [--runs 1000] [--plain-runs 5] [--seed 1] [--json OUT]

Workload: `problems.rendezvous_tracking`, case 1, TVLQR, all dispersions, noise, actuators and the disturbance. The
plain loop states the same closed loop in NumPy, step by step, and integrates the plant over each control step by
solve_ivp (RK45). It gets the same gains, parameters and random numbers, so the states at the end have to agree; both
sides have an error per step far below the tolerance of that comparison.

Five questions:

1. Processor time per run, plain loop over campaign. The plain loop's time leaves design, gains and random
   numbers out; the campaign's has random numbers and parameters in. With building the loop, too: "built".
2. Do the states at the end agree?
3. How many runs a second does one processor fly, design, building and compiling not counted (TVLQR, integral sliding
   mode, predictive control)?
4. Has a campaign with one process per processor the bits of that on one?
5. How many times as long does a run take behind a filter, one that makes its gains in flight and one before it?

Exit code 1 if a target is missed.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from gnc_opt.array_types import Array
from gnc_opt.simulation import Campaign, CompiledLoop
from gnc_opt.spacecraft import (
    RADIUS_EARTH,
    apply,
    hill_acceleration,
    lvlh_rate,
    mean_motion,
    mrp_difference,
    mrp_rate,
    mrp_to_dcm,
    relative_angular_acceleration,
    transpose,
)
from problems.rendezvous import ALTITUDE, MAX_FORCE, MAX_TORQUE
from problems.rendezvous_tracking import DISPERSIONS, DT, FORCE_STEP, NOISE, TORQUE_STEP, Tracking, plan
from problems.rendezvous_tracking.guidance import Filtered

SPEED_UP = 50.0
"""Least accepted ratio of times per run."""
RATES = {"TVLQR": 800.0, "integral sliding mode": 300.0, "MPC": 30.0}
"""Least accepted runs per second of processor time."""
AGREEMENT = 1e-6
"""Of the states at the end, in their units."""
RTOL, ATOL = 1e-8, 1e-9
"""Of solve_ivp, where its time is taken."""
TIGHT = 1e-11
"""Both of them, where the states are compared: commands are rounded to steps of the thrusters, and an error of 1e-8 m
rounds one of them to the other side in every tenth run."""

_LIMIT = np.repeat([MAX_TORQUE, MAX_FORCE], 3)
_STEP = np.repeat([TORQUE_STEP, FORCE_STEP], 3)
_N = mean_motion(RADIUS_EARTH + ALTITUDE)


def plain_run(
    flight: CompiledLoop,
    parameters: dict[str, Array],
    normal: dict[str, Array],
    rows: Array,
    rtol: float = TIGHT,
    atol: float = TIGHT,
) -> Array:
    """Fly one run in plain Python; return the state at the end (n_states,).

    Of the flight it takes the times of the steps alone. Parameters are by dotted name, standard normal numbers (3,
    n_steps) by sensor; rows (n_signals, n_steps) are reference states (12), feedforward (6), gains row by row (72).
    """
    x = np.concatenate([parameters[f"initial.{name}"] for name in ("omega", "sigma", "v_L", "r_L")])
    tau = np.concatenate([parameters["torque lag.tau"], parameters["force lag.tau"]])
    push = parameters["differential force.level"]
    inertia, mass = parameters["plant.inertia"], parameters["plant.mass"][0]
    decay = np.exp(-DT / tau)
    lagged = np.zeros(6)

    def rate(t: float, x: Array, u: Array, gap: Array, begin: float) -> Array:
        applied = u + gap * np.exp(-(t - begin) / tau)
        omega, sigma, v, r = x[:3], x[3:6], x[6:9], x[9:]
        dcm = mrp_to_dcm(sigma)
        spin = relative_angular_acceleration(inertia, omega, apply(dcm, lvlh_rate(_N)), applied[:3])
        force = apply(transpose(dcm), applied[3:]) / mass
        return np.concatenate(
            [spin, mrp_rate(sigma, omega), force + hill_acceleration(r, v, _N) + push, v]
        ).astype(float)

    for k, t in enumerate(flight.times[:-1]):
        seen = x + np.concatenate(
            [
                NOISE["omega"] * normal["sensor 0"][:, k],
                mrp_rate(x[3:6], NOISE["sigma"] * normal["sensor 1"][:, k]),
                NOISE["v_L"] * normal["sensor 2"][:, k],
                NOISE["r_L"] * normal["sensor 3"][:, k],
            ]
        )
        x_ref, u_ff, gain = rows[:12, k], rows[12:18, k], rows[18:, k].reshape(6, 12)
        error = seen - x_ref
        error[3:6] = mrp_difference(seen[3:6], x_ref[3:6])
        u = np.clip(_STEP * np.floor((u_ff - gain @ error) / _STEP + 0.5), -_LIMIT, _LIMIT)
        gap = lagged - u
        lagged = u + gap * decay
        found = solve_ivp(rate, (t, t + DT), x, args=(u, gap, t), rtol=rtol, atol=atol)
        x = found.y[:, -1]
    return np.asarray(x)


def plain_inputs(
    campaign: Campaign, flight: CompiledLoop, index: int
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the parameters and the random numbers of a run of the campaign."""
    layout = flight.layout
    column = campaign.parameters[:, index]
    parameters = {name: column[layout.slice(name)] for name in layout.names}
    first = 1 + flight.schedule.shape[0]
    generator = np.random.Generator(np.random.Philox(np.random.SeedSequence([campaign.seed, index])))
    known = np.zeros((flight.kernel.known.size, flight.n_steps))
    known[first:] = generator.standard_normal((flight.n_steps, known.shape[0] - first)).T
    return parameters, flight.kernel.known.split_vector_by_name(known)


def measure(runs: int, plain_runs: int, seed: int) -> dict[str, Any]:
    """Return all measurements as plain numbers."""
    tracking = Tracking(plan())
    begin = time.process_time()
    serial = tracking.simulate_campaign("TVLQR", runs, seed, executor="serial")
    built = time.process_time() - begin
    assert serial.compiled_loop is not None
    flight = serial.compiled_loop
    begin = time.process_time()
    flight.final_values(serial.parameters, [[seed, i] for i in range(runs)])
    spent = time.process_time() - begin

    rows, seconds, apart = flight.schedule, [], 0.0
    for index in range(min(plain_runs, runs)):
        parameters, normal = plain_inputs(serial, flight, index)
        begin = time.process_time()
        plain_run(flight, parameters, normal, rows, RTOL, ATOL)
        seconds.append(time.process_time() - begin)
        end = plain_run(flight, parameters, normal, rows)
        apart = max(apart, float(np.max(np.abs(end - serial.states[:, index]))))

    rates = {name: rate(tracking, name, runs, seed) for name in RATES}
    parallel = tracking.simulate_campaign("TVLQR", runs, seed)
    plain = float(np.median(seconds))
    return {
        "runs": runs,
        "control_steps": flight.n_steps,
        "dispersions": len(DISPERSIONS),
        "plain_s_per_run": plain,
        "campaign_s_per_run": spent / runs,
        "built_s_per_run": built / runs,
        "speed_up": plain * runs / spent,
        "speed_up_built": plain * runs / built,
        "apart": apart,
        "runs_per_s": rates,
        "filtered_over_plain": filter_costs(tracking, runs, seed),
        "same_bits": bool(np.array_equal(parallel.states, serial.states)),
        "pass_rate": serial.pass_rate().rate,
    }


def flying(tracking: Tracking, name: str, runs: int, seed: int) -> tuple[int, Callable[[], float]]:
    """Return how many runs a function flies whenever it is called, and that function, which tells the time it took."""
    few = tracking.simulate_campaign(name, min(runs, 20), seed, executor="serial")
    assert few.compiled_loop is not None
    flight, P = few.compiled_loop.with_machine_code(1000), np.tile(few.parameters, 5)

    def fly() -> float:
        begin = time.process_time()
        flight.final_values(P, [[seed, i] for i in range(P.shape[1])])
        return time.process_time() - begin

    return P.shape[1], fly


def rate(tracking: Tracking, name: str, runs: int, seed: int) -> float:
    """Return how many runs are flown in a second of processor time."""
    n, fly = flying(tracking, name, runs, seed)
    return n / float(np.median([fly() for _ in range(7)]))


def filter_costs(tracking: Tracking, runs: int, seed: int) -> dict[str, float]:
    """Return the time of runs of the TVLQR behind the filter over those without, flown in turns."""
    filtered = flying(Filtered(tracking.solution), "TVLQR", runs, seed)[1]
    plain = flying(tracking, "TVLQR", runs, seed)[1]
    turns = np.array([[fly() for fly in (plain, filtered)] for _ in range(7)])
    return {"EKF": float(np.median(turns[:, 1] / turns[:, 0]))}


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; 1 if a target is missed."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.performance.closed_loop", description="Speed of campaigns."
    )
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--plain-runs", type=int, default=5, help="of the plain loop, median taken")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, metavar="OUT")
    options = parser.parse_args(arguments)
    results = measure(options.runs, options.plain_runs, options.seed)
    for name, value in results.items():
        print(f"{name}: {value:.4g}" if isinstance(value, float) else f"{name}: {value}")
    rates = results["runs_per_s"]
    missed = [f"{name}, runs per second" for name, least in RATES.items() if rates[name] < least]
    met = results["speed_up"] >= SPEED_UP, results["apart"] <= AGREEMENT, results["same_bits"]
    missed += [name for name, ok in zip(("speed_up", "apart", "same_bits"), met, strict=True) if not ok]
    print(f"targets missed: {', '.join(missed) or 'none'}")
    if options.json is not None:
        options.json.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
    return int(bool(missed))


if __name__ == "__main__":
    raise SystemExit(main())
