"""The planned rendezvous and its regulator in another maker's plant: Basilisk's spacecraft under the Earth's gravity.

``python -m benchmarks.validation.basilisk`` flies the plan three times without disturbances: in the closed loop
of gnc_opt, in Basilisk under the law in Python, and in Basilisk under the law as exported C (where a C compiler is
found), and prints by how much the flights differ. Wanted: ``pip install bsk``.

Basilisk integrates position and velocity of the chaser in inertial axes about the Earth's centre and its whole rigid
body; gnc_opt integrates Hill's linear equations in the target's axes. What is between them at 25 m from the target:

* gravity's second order, 3/2 n^2 r^2 / a = 1.6e-10 m/s^2, which in 50 s moves the free chaser by 2e-7 m;
* rounding: an inertial position of 7e6 m has 1e-9 m, a velocity of 7.5e3 m/s has 1e-12 m/s, in every step.

Axes: the target moves on a circle in the plane of the inertial x and y; L has x along its velocity, y against its
angular momentum, z to the Earth's centre.

Source: P. W. Kenneally, S. Piggott, H. Schaub, "Basilisk: a flexible, scalable and modular astrodynamics simulation
framework", J. Aerospace Information Systems 17 (9), 2020.
"""

from __future__ import annotations

import argparse
import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

import gnc_opt as go
from gnc_opt.array_types import Array
from gnc_opt.control import Controller
from gnc_opt.spacecraft import MU_EARTH, RADIUS_EARTH, mean_motion
from gnc_opt.threads_and_package_versions import import_optional_package
from problems.rendezvous import ALTITUDE, INERTIA, MASS, chaser_model
from problems.rendezvous_tracking.control import DT, Tracking, plan

Law: TypeAlias = Callable[[float, Array], Array]
"""``law(t, x)`` is the command (6,), torques and forces in B, for the step that begins at t."""

ORBIT = RADIUS_EARTH + ALTITUDE
"""Radius of the target's orbit, m."""
PARTS = {
    "omega": (slice(0, 3), "rad/s"),
    "sigma": (slice(3, 6), "-"),
    "v_L": (slice(6, 9), "m/s"),
    "r_L": (slice(9, 12), "m"),
}
"""Where the state has what, and its unit."""


def target(t: float) -> tuple[Array, Array, Array]:
    """Return position (m) and velocity (m/s) of the target in inertial axes N, and dcm_LN (3, 3)."""
    n = mean_motion(ORBIT)
    cosine, sine = np.cos(n * t), np.sin(n * t)
    up, along = np.array([cosine, sine, 0.0]), np.array([-sine, cosine, 0.0])
    return ORBIT * up, n * ORBIT * along, np.array([along, [0.0, 0.0, -1.0], -up])


def _rate_LN_L() -> Array:
    return np.array([0.0, -mean_motion(ORBIT), 0.0])


def to_inertial(t: float, x: Array) -> tuple[Array, Array, Array, Array]:
    """Return r_N, v_N, sigma_BN and omega_BN_B of a relative state (12,)."""
    kinematics = import_optional_package("Basilisk.utilities.RigidBodyKinematics", "peers")
    omega, sigma, v, r = np.split(x, 4)
    r_target, v_target, dcm_LN = target(t)
    dcm_BL = kinematics.MRP2C(sigma)
    return (
        r_target + dcm_LN.T @ r,
        v_target + dcm_LN.T @ (v + np.cross(_rate_LN_L(), r)),
        kinematics.C2MRP(dcm_BL @ dcm_LN),
        omega + dcm_BL @ _rate_LN_L(),
    )


def to_relative(t: float, r_N: Array, v_N: Array, sigma_BN: Array, omega_BN_B: Array) -> Array:
    """Return the relative state (12,) of what `to_inertial` returns."""
    kinematics = import_optional_package("Basilisk.utilities.RigidBodyKinematics", "peers")
    r_target, v_target, dcm_LN = target(t)
    r = dcm_LN @ (r_N - r_target)
    v = dcm_LN @ (v_N - v_target) - np.cross(_rate_LN_L(), r)
    dcm_BL = kinematics.MRP2C(sigma_BN) @ dcm_LN.T
    return np.concatenate([omega_BN_B - dcm_BL @ _rate_LN_L(), kinematics.C2MRP(dcm_BL), v, r])


def fly(law: Law, x0: Array, steps: int, dt: float = DT) -> Array:
    """Return the relative states (12, steps + 1) of a flight in Basilisk from x0 (12,) at t = 0 s.

    Raises
    ------
    GncOptError
        Basilisk is not installed.
    """
    base = import_optional_package("Basilisk.utilities.SimulationBaseClass", "peers").SimBaseClass()
    macros = import_optional_package("Basilisk.utilities.macros", "peers")
    base.CreateNewProcess("process").addTask(base.CreateNewTask("step", macros.sec2nano(dt)))
    hub, _gravity = _spacecraft(x0)  # Basilisk keeps pointers only
    torque_and_force = import_optional_package("Basilisk.simulation.extForceTorque", "peers").ExtForceTorque()
    hub.addDynamicEffector(torque_and_force)
    computer = _computer(law, hub.scStateOutMsg, torque_and_force)
    # at t the plant is brought to t first; then the law reads it, and the effector takes the command for what follows
    for priority, module in ((30, hub), (20, computer), (10, torque_and_force)):
        base.AddModelToTask("step", module, priority)
    base.InitializeSimulation()
    base.ConfigureStopTime(macros.sec2nano(steps * dt))
    base.ExecuteSimulation()
    return np.array(computer.states).T


def _spacecraft(x0: Array) -> tuple[Any, Any]:
    """Basilisk's rigid body under a point mass of our constant, integrated by a method of order 7 (8)."""
    spacecraft = import_optional_package("Basilisk.simulation.spacecraft", "peers")
    integrators = import_optional_package("Basilisk.simulation.svIntegrators", "peers")
    gravity = import_optional_package("Basilisk.utilities.simIncludeGravBody", "peers").gravBodyFactory()
    earth = gravity.createEarth()
    earth.isCentralBody, earth.mu = True, MU_EARTH
    craft = spacecraft.Spacecraft()
    craft.ModelTag = "chaser"
    craft.hub.mHub = MASS
    craft.hub.r_BcB_B = np.zeros((3, 1)).tolist()
    craft.hub.IHubPntBc_B = np.diag(INERTIA).tolist()
    r, v, sigma, omega = to_inertial(0.0, x0)
    craft.hub.r_CN_NInit, craft.hub.v_CN_NInit = r.tolist(), v.tolist()
    craft.hub.sigma_BNInit, craft.hub.omega_BN_BInit = sigma.tolist(), omega.tolist()
    gravity.addBodiesTo(craft)
    craft.setIntegrator(integrators.svIntegratorRKF78(craft))
    return craft, gravity


def _computer(law: Law, state: Any, effector: Any) -> Any:
    """The flight computer as a module of Basilisk: reads the state, writes the command."""
    system = import_optional_package("Basilisk.architecture.sysModel", "peers")
    messaging = import_optional_package("Basilisk.architecture.messaging", "peers")

    class Computer(system.SysModel):  # type: ignore[misc,name-defined]
        def __init__(self) -> None:
            super().__init__()
            self.ModelTag = "law"
            self.states: list[Array] = []
            self.state = messaging.SCStatesMsgReader()
            self.state.subscribeTo(state)
            self.torque, self.force = messaging.CmdTorqueBodyMsg(), messaging.CmdForceBodyMsg()
            effector.cmdTorqueInMsg.subscribeTo(self.torque)
            effector.cmdForceBodyInMsg.subscribeTo(self.force)

        def UpdateState(self, nanoseconds: int) -> None:
            t, found = 1e-9 * nanoseconds, self.state()
            inertial = (found.r_CN_N, found.v_CN_N, found.sigma_BN, found.omega_BN_B)
            x = to_relative(t, *(np.array(part) for part in inertial))
            self.states.append(x)
            command = law(t, x)
            torque, force = messaging.CmdTorqueBodyMsgPayload(), messaging.CmdForceBodyMsgPayload()
            torque.torqueRequestBody, force.forceRequestBody = command[:3].tolist(), command[3:].tolist()
            self.torque.write(torque, nanoseconds)
            self.force.write(force, nanoseconds)

    return Computer()


def python_law(controller: Controller) -> Law:
    """Return the law in Python, with its memory."""
    memory: Array | None = None

    def command(t: float, x: Array) -> Array:
        nonlocal memory
        u, memory = controller(t, x, memory)
        return u

    return command


def compiled_law(controller: Controller, folder: str | Path) -> Law:
    """Return the law as the C that `gnc_opt.export_c` writes, compiled by ``cc`` in a folder."""
    code = go.export_c(controller, folder, name="law")
    library = code.source.with_suffix(".so")
    flags = ["-std=c99", "-O2", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, "-o", str(library), str(code.source), "-lm"], check=True)
    c = ctypes.CDLL(str(library))
    z, u = np.zeros(max(controller.memory.size, 1)), np.zeros(controller.commands.size)
    begun = False

    def pointer(array: Array) -> Any:
        return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))

    def command(t: float, x: Array) -> Array:
        nonlocal begun
        now, measured = ctypes.c_double(t), np.ascontiguousarray(x, dtype=float)
        if not begun:
            c.law_start(now, pointer(measured), pointer(z))
        begun = True
        c.law_step(now, pointer(measured), pointer(z), pointer(u))
        return u.copy()

    return command


def start(tracking: Tracking) -> Array:
    """Return a start beside the planned one, so that the feedback works: 0.1 m, 1 deg."""
    off = np.zeros(12)
    off[3:6] = np.tan(np.deg2rad(1.0) / 4) * np.array([0.6, 0.0, 0.8])
    off[9:12] = [0.06, -0.08, 0.0]
    return tracking.initial + off


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly in gnc_opt and in Basilisk, print the differences."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.validation.basilisk", description=main.__doc__
    )
    parser.add_argument("--case", type=int, default=1, help="initial position, 1 to 5 (1)")
    case = parser.parse_args(arguments).case
    tracking = Tracking(plan(case))
    controller = tracking.tvlqr
    x0, steps = start(tracking), round(tracking.end / DT)
    run = go.ClosedLoop(chaser_model("exact"), controller, dt=DT, accuracy=1e-12).simulate(
        x0=x0, tf=steps * DT
    )
    print(f"{steps} control steps of {DT:g} s; largest differences from the closed loop of gnc_opt")
    print(f"{'':24}" + "".join(f"{name + ', ' + unit:>14}" for name, (_, unit) in PARTS.items()))
    with tempfile.TemporaryDirectory() as folder:
        laws = {"law in Python": python_law(controller)}
        if shutil.which("cc"):
            laws["law in C"] = compiled_law(controller, folder)
        for name, law in laws.items():
            apart = np.max(np.abs(fly(law, x0, steps) - run.states), axis=1)
            cells = "".join(f"{np.max(apart[part]):14.1e}" for part, _ in PARTS.values())
            print(f"Basilisk, {name:<14}{cells}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
