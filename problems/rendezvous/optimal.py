"""What is known of the optima: minimum times with their sources, and the bang-bang structure of the best ones."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import gnc_opt as go
from problems._example import Reference
from problems.rendezvous.model import CASES, EQUATIONS, Equation, check_case

_DATA = json.loads(Path(__file__).with_name("optimal.json").read_text(encoding="utf-8"))

_SOURCES = {
    "20x3": ("independent collocation, 20 x 3 LG points", 2e-4),
    "exact": ("independent, switch times optimised", 1e-8),
    "paper GPM": ("the paper, table 4, 20 x 3 LG points", 2e-4),
    "paper GPOPS": ("the paper, table 4, GPOPS", 1e-2),
}
"""Of minimum times, and their tolerances (s)."""

REFERENCE: dict[tuple[int, Equation], dict[str, Reference]] = {
    (case, equation): {
        key: Reference(value, *_SOURCES[key], "s")
        for key, value in _DATA[str(case)]["minimum times"][equation].items()
    }
    for equation in EQUATIONS
    for case in CASES
}
"""By (case, equation): minimum times on the paper's mesh ("20x3"), with optimal switch times ("exact", best known), and
as published ("paper GPM", "paper GPOPS"): those of cases 2 and 5, and the latter of 3 and 4, are other local minima."""


@dataclass(frozen=True)
class Channel:
    """The bang-bang structure of one control: its sign at the start and the times (s) at which it changes."""

    initial_sign: int
    switching_times: tuple[float, ...]


SWITCHES: dict[int, dict[str, Channel]] = {
    case: {
        label: Channel(sign, tuple(times)) for label, (sign, times) in _DATA[str(case)]["switches"].items()
    }
    for case in CASES
}
"""Structure of the best known solutions, printed equation, by case and control component. Case 1 also exists mirrored
at the orbital plane (signs of T_B[0], T_B[2] and F_B[1] reversed). Some arcs are shallow: in case 1 the switching
function of T_B[0] between 6.65 and 7.08 s is 6e-5 of its peak."""


def switch_mesh(case: int = 1, degree: int = 8, *, movable: bool = False) -> go.Mesh:
    """Return a mesh with a segment boundary at every switch of the best known solution (printed equation).

    Parameters
    ----------
    case : int
    degree : int
        Collocation points per segment.
    movable : bool
        Let the solver move the boundaries. With the controls held as in `switch_arcs`, the switch times are
        then what is optimised.
    """
    check_case(case)
    t_f = REFERENCE[case, "printed"]["exact"].value
    return go.Mesh.at_times([0.0, *_all_switches(case), t_f], degree, movable=movable)


def switch_arcs(case: int = 1) -> NDArray[np.int64]:
    """Return the sign of every control (6) in every segment of `switch_mesh`, for ``Problem.with_fixed_arcs``."""
    check_case(case)
    edges = np.array([0.0, *_all_switches(case)])
    rows = [
        channel.initial_sign * (-1) ** np.searchsorted(channel.switching_times, edges, side="right")
        for channel in SWITCHES[case].values()
    ]
    return np.array(rows, dtype=np.int64)


def _all_switches(case: int) -> list[float]:
    return sorted(t for channel in SWITCHES[case].values() for t in channel.switching_times)
