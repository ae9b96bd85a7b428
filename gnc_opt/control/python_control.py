"""Linear plants and sampled laws as systems of python-control, the package of the extra ``control``."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from gnc_opt.arrays import Array
from gnc_opt.extras import imported
from gnc_opt.model.layout import Layout


def linear_system(
    name: str, matrices: tuple[Array, Array, Array, Array], dt: float, *layouts: tuple[str, ...]
) -> Any:
    """Return a ``control.StateSpace``.

    Parameters
    ----------
    name : str
    matrices : tuple of four arrays
        A, B, C, D.
    dt : float
        Step, s; 0 for continuous time.
    *layouts : three tuples of str
        Names of the states, inputs and outputs.
    """
    states, inputs, outputs = (list(labels) for labels in layouts)
    package = imported("control", "control")
    return package.ss(*matrices, dt, name=_name(name), states=states, inputs=inputs, outputs=outputs)


def sampled_system(
    name: str,
    step: Callable[[float, Array, Array], tuple[Array, Array]],
    dt: float,
    memory: Layout,
    measured: Layout,
    commands: Layout,
) -> Any:
    """Return a ``control.NonlinearIOSystem`` with steps of dt (s).

    Parameters
    ----------
    name : str
    step : callable
        ``step(t, z, x)`` returns the command and the next memory.
    dt : float
    memory, measured, commands : Layout
        Of the state z, the input x and the output.
    """
    package = imported("control", "control")

    def update(t: float, z: Array, x: Array, params: object) -> Array:
        return step(t, z, x)[1]

    def output(t: float, z: Array, x: Array, params: object) -> Array:
        return step(t, z, x)[0]

    return package.nlsys(
        update,
        output,
        dt=dt,
        name=_name(name),
        states=list(memory.labels),
        inputs=list(measured.labels),
        outputs=list(commands.labels),
    )


def _name(name: str) -> str:
    """Return a name of letters, digits and underscores: a dot would separate a system from its signal."""
    return re.sub(r"\W+", "_", name)
