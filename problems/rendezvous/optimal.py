"""What is known of the optima: minimum times with their sources, and the bang-bang structure of the best ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import gnc_opt as go
from problems._example import Reference
from problems.rendezvous.model import CASES, EQUATIONS, Equation, check_case


def _references() -> dict[tuple[int, Equation], dict[str, Reference]]:
    on_mesh: dict[Equation, tuple[float, ...]] = {
        "printed": (25.872707, 25.789173, 25.935949, 25.660546, 28.279790),
        "exact": (25.873064, 25.789525, 25.936542, 25.660937, 28.280283),
    }
    by_switch_times: dict[Equation, tuple[float, ...]] = {
        "printed": (25.8699620765, 25.7871807680, 25.9323677271, 25.6589517308, 28.2784271292),
        "exact": (25.8703529462, 25.7875628033, 25.9329944836, 25.6593186424, 28.2789359679),
    }
    gpm, gpops = (25.8727, 26.1674, 25.9360, 25.6607, 28.7185), (25.87, 26.0336, 26.1652, 25.8986, 28.2784)
    sources = {
        "20x3": "independent collocation, 20 x 3 LG points",
        "exact": "independent, switch times optimised",
        "paper GPM": "the paper, table 4, 20 x 3 LG points",
        "paper GPOPS": "the paper, table 4, GPOPS",
    }
    tolerances = {"20x3": 2e-4, "exact": 1e-8, "paper GPM": 2e-4, "paper GPOPS": 1e-2}
    table: dict[tuple[int, Equation], dict[str, Reference]] = {}
    for equation in EQUATIONS:
        for i, case in enumerate(CASES):
            known = {"20x3": on_mesh[equation][i], "exact": by_switch_times[equation][i]}
            if equation == "printed":
                known |= {"paper GPM": gpm[i], "paper GPOPS": gpops[i]}
            table[case, equation] = {
                key: Reference(value, sources[key], tolerances[key], "s") for key, value in known.items()
            }
    return table


REFERENCE = _references()
"""By (case, equation): minimum times on the paper's mesh ("20x3"), with optimal switch times ("exact", best
known), and as published ("paper GPM", "paper GPOPS")."""

OTHER_MINIMA = frozenset(
    {(2, "paper GPM"), (5, "paper GPM"), (2, "paper GPOPS"), (3, "paper GPOPS"), (4, "paper GPOPS")}
)
"""Published times (case, key) that are other local minima, up to 0.44 s slower than the best."""


@dataclass(frozen=True)
class Channel:
    """The bang-bang structure of one control: its sign at the start and the times (s) at which it changes."""

    initial_sign: int
    switching_times: tuple[float, ...]


def _channels(*rows: tuple[int, tuple[float, ...]]) -> dict[str, Channel]:
    labels = [f"{name}[{i}]" for name in ("T_B", "F_B") for i in range(3)]
    return {label: Channel(*row) for label, row in zip(labels, rows, strict=True)}


SWITCHES: dict[int, dict[str, Channel]] = {
    1: _channels(
        (-1, (5.563493, 6.649508, 7.080075, 18.551166)),
        (+1, (8.851215, 13.081496, 16.392395)),
        (+1, (5.490388, 15.096468, 22.315605)),
        (-1, (13.592304, 20.713493)),
        (-1, (1.892381, 12.478192, 22.298079)),
        (-1, (0.363928, 0.930261, 11.192783)),
    ),
    2: _channels(
        (+1, (5.015306, 6.436348, 7.504666, 18.638841)),
        (+1, (9.005886, 13.049221, 16.296257)),
        (-1, (5.377361, 14.844080, 22.151364)),
        (-1, (13.554639, 20.776492)),
        (+1, (0.982735, 12.450702, 23.132659)),
        (-1, (0.376265, 0.940078, 11.171878)),
    ),
    3: _channels(
        (+1, (6.146040, 19.018058)),
        (+1, (11.510661, 24.779260)),
        (-1, (5.103003, 13.852381, 21.639787)),
        (-1, (12.816076, 18.640924)),
        (+1, (0.918488, 12.274986, 23.489345)),
        (-1, (11.709127,)),
    ),
    4: _channels(
        (+1, (4.240161, 6.579451, 8.310947, 18.521655)),
        (+1, (9.162451, 13.036463, 16.009541)),
        (-1, (5.513475, 15.387877, 22.429593)),
        (-1, (13.348285, 21.502540)),
        (+1, (1.007522, 12.591349, 22.991177)),
        (+1, (1.973302, 11.455614)),
    ),
    5: _channels(
        (-1, (3.323138, 6.393915, 10.450251, 21.136521)),
        (+1, (8.769126, 14.168439, 19.082897)),
        (+1, (5.852281, 16.738143, 24.750816)),
        (-1, (14.641626, 24.454912)),
        (-1, (0.890946, 13.998180, 25.393987)),
        (+1, (2.010162, 12.678186)),
    ),
}
"""Structure of the best known solutions, printed equation, by case and control component. Case 1 also exists
mirrored at the orbital plane (signs of T_B[0], T_B[2] and F_B[1] reversed). Some arcs are shallow: in case 1
the switching function of T_B[0] between 6.65 and 7.08 s is 6e-5 of its peak."""


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
