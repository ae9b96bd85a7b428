"""Small pictures of solved problems for the page of examples: one pair of axes, at most three curves.

`benchmarks.validation.engine --pictures` draws them of the solutions that it measures, into ``docs/pictures``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from PIL import Image

import gnc_opt as go
from gnc_opt.planning.solution.solution_summary import time_unit
from gnc_opt.plot.figure_style import COLORS, apply_plot_style, format_unit, format_variable_name
from gnc_opt.plot.time_plot_axes import sample_piecewise_function

FOLDER = Path(__file__).parents[1] / "docs" / "pictures"

SIZE_IN, DPI = (2.4, 1.5), 120

_RAISED = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")

AXES = {
    "aeroassisted_plane_change": "v h",
    "aerocapture": "v h",
    "air_launch": "theta h",
    "albatross": "v h",
    "apollo_lunar_descent": "theta h",
    "asteroid_landing": "r:0 r:1",
    "attitude_control": "t omega",
    "balanced_field": "r v",
    "belly_flop": "x z",
    "boost_glide": "theta h",
    "booster_landing": "x z",
    "brachistochrone": "x y",
    "bryson_denham": "t x",
    "cannonball": "r h",
    "climb": "v h",
    "container_crane": "t phi",
    "cw_fuel": "r:0 r:1",
    "cw_thrust": "r:0 r:1",
    "delta3": "t m",
    "detumble": "t w",
    "dielectrophoretic_particle": "x y",
    "docking_corridor": "r:0 r:1",
    "double_oscillator": "x1 x2",
    "dubins_path": "x y",
    "ducted_fan": "x1 x2",
    "earth_mars": "r:0 r:1",
    "eclipse_orbit_raising": "polar r theta",
    "edelbaum_transfer": "V i",
    "elliptic_rendezvous": "x y",
    "finite_burn": "polar r theta",
    "floating_oscillator": "x1 x2",
    "formation_flying": "r:0 r:1",
    "geo_station_keeping": "lam D",
    "goddard_speed_limit": "t v",
    "gto_to_geo": "orbit P ex ey L",
    "hang_glider": "x y",
    "heading_reversal": "chi h",
    "hypersensitive": "x u",
    "interior_point": "t x",
    "j2_orbit_raising": "orbit p f g t",
    "keep_out_rendezvous": "r:0 r:1",
    "libration_transfer": "x y",
    "low_thrust_transfer": "orbit p f g L",
    "lunar_ascent": "theta h",
    "magnetic_unloading": "t h",
    "mars_entry": "v h",
    "mars_landing": "r:0 r:2",
    "minimum_fuel": "t v",
    "missile_seeker": "x y",
    "missile_terminal_burn": "x h",
    "moon_landing": "v h",
    "mountain_car": "x v",
    "no_fly_zones": "lon lat",
    "orbit_raising": "t r",
    "perching": "x z",
    "periodic": "t x",
    "quadrotor": "p:0 p:1",
    "quadrotor_flip": "x z",
    "quadrotor_time_optimal": "p:1 p:2",
    "rayleigh": "x1 x2",
    "rendezvous": "r_L:0 r_L:2",
    "robot_arm": "theta phi",
    "rocket_landing": "r:0 r:2",
    "shuttle": "v h",
    "single_stage_ascent": "x y",
    "six_dof_landing": "r:0 r:2",
    "solar_sail_mars": "polar r theta",
    "space_robot": "q1 q2",
    "speed_limit": "t v",
    "station_momentum": "t h",
    "tethered_formation": "lead height",
    "truck_trailers": "x2 y2",
    "tumbling_target": "r:0 r:1",
    "turn_back": "x y",
    "two_burn_transfer": "orbit p f g L",
    "two_link_arm": "elbow shoulder",
    "two_stage_ascent": "theta h",
    "van_der_pol": "x y",
    "wind_shear_landing": "x h",
    "zermelo": "x y",
}
"""What is drawn over what: time ``t``, a state, a component of it (``r:0``); "polar" and "orbit" draw the path of polar
coordinates and of equinoctial elements. All other problems: the first control over time."""


def describe_axes(name: str) -> str:
    """Return what the picture of an example shows, for a caption."""
    kind, *names = AXES.get(name, "t control").split()
    if kind in ("polar", "orbit"):
        return "orbit"
    across, up = (re.sub(r":(\d)", _component, part) for part in (kind, *names))
    return f"{up} over {'time' if across == 't' else across}"


def _component(found: re.Match[str]) -> str:
    """Return the subscript of a component as the axis shows it, from 1: ``r:0`` is r_1."""
    return f"{',' if '_' in found.string else '_'}{int(found[1]) + 1}"


def superscripts(text: str) -> str:
    """Return a text with exponents as raised digits."""
    return re.sub(r"\^(\d+)", lambda found: found[1].translate(_RAISED), text)


def draw(name: str, solution: go.Solution) -> Figure:
    """Return the small picture of the solution of an example."""
    with apply_plot_style():
        figure = Figure(figsize=SIZE_IN, dpi=DPI, layout="constrained")
        ax = figure.subplots()
        kind, *names = (AXES.get(name) or _first_control(solution)).split()
        for leg in solution.phases.values():
            if kind in ("polar", "orbit"):
                _draw_orbit(ax, leg, names)
            else:
                _draw_curves(ax, leg, kind, names[0])
        if kind == "t":
            ax.set_xlabel(f"time ({time_unit(solution)})")
        if kind in ("polar", "orbit"):
            ax.set_aspect("equal", adjustable="datalim")
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_locator(MaxNLocator(3))
            axis.label.set_fontsize(10)
            axis.get_offset_text().set_fontsize(9)
        ax.tick_params(labelsize=9)
    return figure


def _first_control(solution: go.Solution) -> str:
    return next(f"t {leg.controls.names[0]}" for leg in solution.phases.values() if leg.controls.names)


def _draw_curves(ax: Axes, leg: go.PhaseSolution, across: str, up: str) -> None:
    known = (*leg.states.names, *leg.controls.names)
    if any(part.partition(":")[0] not in known for part in (across, up) if part != "t"):
        return  # a state of other phases
    (x, _), (y, label) = (_values(leg, part) for part in (across, up))
    for i, row in enumerate(y[:3]):
        ax.plot(x[0], row, color=COLORS[i], linewidth=1.8)
    ax.set_xlabel(_values(leg, across)[1])
    ax.set_ylabel(label)


def _draw_orbit(ax: Axes, leg: go.PhaseSolution, names: Sequence[str]) -> None:
    """Draw the path of a radius and an angle, or of ``p``, ``f``, ``g`` and the longitude, in the plane."""
    t = np.linspace(leg.breaks[0], leg.breaks[-1], 4000)
    *elements, angle = (np.ravel(leg.state(n)(t)) if n != "t" else t for n in names)
    if len(elements) == 1:
        radius = elements[0]
    else:
        p, f, g = elements
        radius = p / (1.0 + f * np.cos(angle) + g * np.sin(angle))
    ax.plot(radius * np.cos(angle), radius * np.sin(angle), color=COLORS[0], linewidth=0.8)
    unit = leg.state(names[0]).unit
    ax.set_xlabel(f"x{f' ({format_unit(unit)})' if unit else ''}")
    ax.set_ylabel("y")


def _values(leg: go.PhaseSolution, part: str) -> tuple[NDArray[np.float64], str]:
    """Return values (n, n_times) between the breaks of a phase, and the label of the axis."""
    name, _, component = part.partition(":")
    if name == "t":
        t, _ = sample_piecewise_function(leg.state(leg.states.names[0]), leg.applied.jump_times)
        return t[None, :], "t"
    signal = leg.saturated_control(name) if name in leg.controls.names else leg.state(name)
    _, values = sample_piecewise_function(signal, leg.applied.jump_times)
    text = format_variable_name(name)
    if component:
        row = int(component)
        sub = f"{text[:-2]},{row + 1}}}$" if text.endswith("}$") else f"{text.rstrip('$')}_{row + 1}$"
        values, text = values[[row]], sub
    return values, f"{text} ({format_unit(signal.unit)})" if signal.unit else text


def save(name: str, solution: go.Solution, folder: Path = FOLDER) -> Path:
    """Write the small picture as PNG of 64 colours and return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.png"
    draw(name, solution).savefig(path, dpi=DPI, metadata={"Software": None})
    Image.open(path).convert("RGB").quantize(64).save(path, optimize=True)
    return path
