"""Flight code compared with its law: compiled, and run over the samples of a flight."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import read_numbers
from gnc_opt.arrays import Array
from gnc_opt.control.controller import Controller
from gnc_opt.errors import ArgumentError, GncOptError

_FLAGS = ("-std=c99", "-O1", "-ffp-contract=off")


def command_error(
    controller: Controller, source: Path, driver: Path, samples: tuple[ArrayLike, ArrayLike], dt: float
) -> Array:
    """Return the largest difference (n_commands,) of the compiled code's commands from the law's over a flight.

    Parameters
    ----------
    controller : Controller
        The law.
    source, driver : Path
        Its flight code.
    samples : (times (n,), measured (n_states, n))
        One control step after the other.
    dt : float
        Control step, s.

    Raises
    ------
    ArgumentError
        Samples of another shape.
    GncOptError
        There is no C compiler, or it failed.
    """
    times, measured = _read(controller, samples)
    compiler = shutil.which("cc")
    if compiler is None:
        raise GncOptError(
            "no C compiler (cc) is found to compare flight code with its law: install one, or leave samples out."
        )
    expected, z = np.empty((controller.commands.size, times.size)), None
    for k, t in enumerate(times):
        expected[:, k], z = controller(t, measured[:, k], z, dt)
    with tempfile.TemporaryDirectory() as folder:
        program = str(Path(folder, "driver"))
        command = [compiler, *_FLAGS, "-o", program, str(source), str(driver), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise GncOptError(f"{compiler} could not compile the flight code: {done.stderr.strip()[:500]}")
        lines = [" ".join(repr(float(v)) for v in (t, *x)) for t, x in zip(times, measured.T, strict=True)]
        told = subprocess.run([program], input="\n".join(lines), capture_output=True, text=True, check=True)
    found = np.array([[float(v) for v in line.split()] for line in told.stdout.splitlines()]).T
    return np.asarray(np.max(np.abs(found - expected), axis=1))


def _read(controller: Controller, samples: tuple[ArrayLike, ArrayLike]) -> tuple[Array, Array]:
    remedy = "give (times (n,), measured (n_states, n)), for example (run.times[:-1], run.measured)"
    if not isinstance(samples, tuple) or len(samples) != 2:
        raise ArgumentError(f"the samples of export_c() are no pair: {remedy}.")
    times, measured = (read_numbers(s, "the samples of export_c()", ArgumentError) for s in samples)
    if times.ndim != 1 or times.size == 0 or measured.shape != (controller.states.size, times.size):
        raise ArgumentError(
            f"the samples of export_c() have the shapes {times.shape} and {measured.shape}, and "
            f"'{controller.name}' measures {controller.states.size} states: {remedy}."
        )
    return times, measured
