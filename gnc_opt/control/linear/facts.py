"""Facts of a steady regulator: its poles, its margins, how well its Riccati equation is solved."""

from __future__ import annotations

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.control.explanation import Fact
from gnc_opt.control.linear.margins import margins
from gnc_opt.control.linear.riccati import Steady
from gnc_opt.control.poles import continuous_poles


def regulator_facts(
    regulator: Steady,
    plant: tuple[Array, Array],
    dt: float | None,
    *,
    name: str = "closed-loop poles",
    remark: str = "slowest first",
) -> list[Fact]:
    """Return the facts of a regulator and its plant (A, B), sampled with dt (s) or continuous."""
    poles = continuous_poles(regulator.poles, dt)
    residual = "left side over its largest term, computed from P alone"
    return [
        Fact(name, poles, "1/s", remark),
        *_margin_facts(*plant, regulator.gain, dt),
        Fact("Riccati residual", regulator.residual, "", residual),
    ]


def _margin_facts(a: Array, b: Array, gain: Array, dt: float | None) -> list[Fact]:
    """Return the facts about the margins at the plant's input."""
    found = margins(a, b, gain, dt)
    alpha = found.disk
    both = f"all gains at once by a factor {max(2 - alpha, 0) / (2 + alpha):.3g} to its inverse"
    return [
        Fact("gain margin up", found.gain_up, "", "per control, the others closed"),
        Fact("gain margin down", found.gain_down, "", "per control, the others closed"),
        Fact("phase margin", np.degrees(found.phase), "deg", "per control, the others closed"),
        Fact("delay margin", found.delay, "s", "per control, the others closed"),
        Fact("disk margin", alpha, "", both),
    ]
