"""Facts of the plant: inertia left for fast torques, free modes, energy, momentum and an open-loop manoeuvre."""

from __future__ import annotations

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.control import Reference, feedforward
from gnc_opt.simulation import ClosedLoop, Run
from gnc_opt.spacecraft import FlexibleBody
from problems.comparison import Row, compare, require
from problems.flexible_spacecraft.model import (
    BODY,
    COUPLING,
    DAMPING,
    FREQUENCIES,
    FULL,
    INERTIA,
    build_model,
    flexible_body,
)

ONE_DIGIT = ((6.4, -1.2, 1.1, 1.2), (1.2, 0.9, 2.5, -2.6), (2.2, -1.7, -0.8, -1.1))
"""The coupling as printed; its first entry may also be 7."""

TORQUE = (0.3, -0.2, 0.1)
"""Of the open-loop manoeuvre, N m."""


def open_loop(body: FlexibleBody, x0: Array, torque: tuple[float, ...], tf: float) -> Run:
    """Return the run under a constant torque (N m) in inertial space."""
    model = build_model(body, 0.0)
    hold = feedforward(Reference.constant(model, x0, torque))
    return ClosedLoop(model, hold, dt=0.1, accuracy=1e-8).simulate(x0, tf=tf)


OPEN_LOOP = {
    10.0: (
        (0.993636, 0.075654, -0.067745, 0.048721),
        (0.028010, -0.028103, 0.017091),
        (-0.039270, -0.010578, 0.001870, -0.001770),
        (0.021198, -0.017603, -0.000278, -0.001630),
    ),
    20.0: (
        (0.902021, 0.286881, -0.278066, 0.163516),
        (0.055001, -0.062073, 0.026866),
        (-0.016165, 0.021304, 0.001458, -0.002285),
        (0.024448, -0.016337, -0.000824, 0.000444),
    ),
}
"""States q, omega, eta, eta_rate at times (s), from rest at q = (1, 0, 0, 0) under `TORQUE`."""

VIBRATING = np.array([1.0, 0, 0, 0, 0.02, -0.03, 0.04, 0.05, -0.02, 0.01, 0.02, 0.01, 0.02, -0.03, 0.01])
"""Start of the runs without torque."""


def plant_rows() -> list[Row]:
    """Return the rows of the plant's facts."""
    masses = np.linalg.eigvalsh(BODY.mass_matrix)
    effect = np.diag(np.linalg.inv(BODY.rigid_inertia)) * np.array(INERTIA)
    rigid = [
        compare(
            "J - C C^T, eigenvalues (kg m^2)",
            (31.0148, 56.8671, 65.93),
            np.linalg.eigvalsh(BODY.rigid_inertia),
            absolute=1e-3,
        ),
        *(
            compare(
                f"the same, C cut to one digit, C11 = {corner:g}",
                expected,
                np.linalg.eigvalsh(_cut_body(corner).rigid_inertia),
                absolute=1e-3,
            )
            for corner, expected in (
                (6.4, (31.1221, 57.5226, 66.4653)),
                (7.0, (27.0009, 55.8674, 64.2014)),
            )
        ),
        compare(
            "mass matrix, extreme eigenvalues", (0.41711, 100.4634), (masses[0], masses[-1]), absolute=1e-3
        ),
        compare(
            "fast torques: effect relative to 1/J_i",
            (2.065, 1.292, 1.356),
            effect,
            absolute=1e-3,
            published="1, 1, 1",
            reason="g_i = 1/J_i leaves out the modes",
        ),
    ]
    return rigid + _frequency_rows() + _deflection_rows() + _energy_rows() + _open_loop_rows()


def _cut_body(corner: float) -> FlexibleBody:
    coupling = np.array(ONE_DIGIT)
    coupling[0, 0] = corner
    return flexible_body(coupling, FREQUENCIES, DAMPING)


def _frequency_rows() -> list[Row]:
    facts = (
        (BODY, "rounded", (0.93716, 1.1624, 1.92258, 2.70095), (0.007743, 0.009684, 0.01374, 0.027148)),
        (FULL, "full", (1.03067, 1.27956, 2.00133, 2.75516), (0.007734, 0.009693, 0.013958, 0.026928)),
    )
    rows = []
    for body, name, frequencies, damping in facts:
        where = f"free body, {name} data"
        rows.append(
            compare(f"frequencies, {where} (rad/s)", frequencies, body.free_frequencies(), relative=1e-4)
        )
        rows.append(compare(f"damping ratios, {where}", damping, body.free_damping(), relative=1e-4))
    return rows


def _deflection_rows() -> list[Row]:
    turning = np.array(TORQUE) / np.array(INERTIA)
    deflection = -(np.array(COUPLING).T @ turning) / np.square(FREQUENCIES)
    # the model agrees: with that deflection no mode is accelerated
    bending = BODY.accelerations(np.zeros(3), deflection, np.zeros(4), np.array(TORQUE))[1]
    return [
        compare(
            "quasi-static deflection under (.3, -.2, .1) N m (kg^.5 m)",
            (-0.041374, 0.009561, 0.001531, -0.001368),
            deflection,
            absolute=1e-6,
        ),
        require(
            "modal accelerations there", "< 1e-15", np.max(np.abs(bending)), np.max(np.abs(bending)) < 1e-15
        ),
    ]


def _energy_rows() -> list[Row]:
    still = flexible_body(COUPLING, FREQUENCIES, np.zeros(4))
    free, damped = (open_loop(body, VIBRATING, (0.0, 0.0, 0.0), 200.0) for body in (still, BODY))
    energy, lost = (
        BODY.energy(run.state("omega").values, run.state("eta").values, run.state("eta_rate").values)
        for run in (free, damped)
    )
    momenta = [
        np.linalg.norm(BODY.momentum(run.state("omega").values, run.state("eta_rate").values), axis=0)
        for run in (free, damped)
    ]
    drift = float(np.max(np.abs(energy / energy[0] - 1)))
    turn = max(float(np.max(np.abs(h / h[0] - 1))) for h in momenta)
    steps = float(np.max(np.diff(lost)))
    return [
        compare("energy at the start (J)", 0.099272491, energy[0], absolute=1e-9),
        compare("momentum at the start (N m s)", 3.669376982, momenta[0][0], absolute=1e-9),
        require("energy drift in 200 s, undamped", "< 1e-8", drift, drift < 1e-8),
        require("momentum drift in 200 s, undamped and damped", "< 1e-8", turn, turn < 1e-8),
        compare("energy after 200 s, damped (J)", 0.09650836, lost[-1], absolute=1e-6),
        require("largest gain of energy in a step, damped (J)", "< 0", steps, steps < 0),
    ]


def _open_loop_rows() -> list[Row]:
    start = np.zeros(15)
    start[0] = 1.0
    run = open_loop(BODY, start, TORQUE, 20.0)
    rows = []
    for t, states in OPEN_LOOP.items():
        for name, expected in zip(("q_BO", "omega", "eta", "eta_rate"), states, strict=True):
            rows.append(compare(f"open loop, {name} at {t:g} s", expected, run.state(name)(t), absolute=2e-6))
    return rows
