"""The figures of the rendezvous paper, numbered as there (3 to 15), and the switching functions."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from matplotlib.figure import Figure

import gnc_opt as go
from gnc_opt.plot.controls import plot_controls
from gnc_opt.plot.path import plot_curves, plot_path
from gnc_opt.plot.trajectory import plot_costates, plot_hamiltonian, plot_states
from gnc_opt.spacecraft import mrp_to_dcm, mrp_to_euler

_AXES_ALONG_PATH = 9


def _components(symbol: str) -> tuple[str, str, str]:
    return f"${symbol}_x$", f"${symbol}_y$", f"${symbol}_z$"


def _costate(symbol: str) -> tuple[str, str, str]:
    return rf"$\lambda_{{{symbol},x}}$", rf"$\lambda_{{{symbol},y}}$", rf"$\lambda_{{{symbol},z}}$"


LABELS = {
    "omega": _components(r"\omega"),
    "sigma": _components(r"\sigma"),
    "v_L": _components("v"),
    "r_L": _components("r"),
    "T_B": _components("T"),
    "F_B": _components("F"),
}

COSTATE_LABELS = {
    "omega": _costate(r"\omega"),
    "sigma": _costate(r"\sigma"),
    "v_L": _costate("v"),
    "r_L": _costate("r"),
}


def paper_figures(solution: go.Solution) -> dict[str, Figure]:
    """Return the figures by file stem, ``fig03_torques`` to ``fig15_hamiltonian``."""
    drawers: dict[str, Callable[[], Figure]] = {
        "fig03_torques": partial(plot_controls, solution, ["T_B"], labels=LABELS),
        "fig04_forces": partial(plot_controls, solution, ["F_B"], labels=LABELS),
        "fig05_rates": partial(plot_states, solution, ["omega"], labels=LABELS),
        "fig06_mrp": partial(plot_states, solution, ["sigma"], labels=LABELS),
        "fig07_euler_angles": partial(plot_euler_angles, solution),
        "fig08_velocity": partial(plot_states, solution, ["v_L"], labels=LABELS),
        "fig09_position": partial(plot_states, solution, ["r_L"], labels=LABELS),
        "fig10_path": partial(plot_approach, solution),
        "fig11_costate_omega": partial(
            plot_costates, solution, ["omega"], labels=COSTATE_LABELS, cost_unit="s"
        ),
        "fig12_costate_sigma": partial(
            plot_costates, solution, ["sigma"], labels=COSTATE_LABELS, cost_unit="s"
        ),
        "fig13_costate_v": partial(plot_costates, solution, ["v_L"], labels=COSTATE_LABELS, cost_unit="s"),
        "fig14_costate_r": partial(plot_costates, solution, ["r_L"], labels=COSTATE_LABELS, cost_unit="s"),
        "fig15_hamiltonian": partial(plot_hamiltonian, solution, expected=-1.0),
    }
    return {stem: draw() for stem, draw in drawers.items()}


def plot_euler_angles(solution: go.Solution) -> Figure:
    """Draw the Euler angles of B relative to L, order YXZ, in degrees."""
    t = solution.phase().sample_times(24)
    angles = np.degrees(np.unwrap(mrp_to_euler(np.asarray(solution.state("sigma")(t)), "YXZ"), axis=1))
    labels = (r"$\theta_y$ (first turn)", r"$\theta_x$ (second)", r"$\theta_z$ (third)")
    return plot_curves(t, angles, labels, "Euler angles YXZ (deg)")


def plot_approach(solution: go.Solution) -> Figure:
    """Draw the path in the LVLH frame with the chaser's axes along it."""
    leg = solution.phase()
    t = leg.sample_times(24)
    shown = np.linspace(0, t.size - 1, _AXES_ALONG_PATH).astype(int)
    dcm_BL = mrp_to_dcm(np.asarray(leg.state("sigma")(t)))
    notes = ("along velocity", "cross-track", "to Earth")
    return plot_path(
        np.asarray(leg.state("r_L")(t)), dcm_BL=dcm_BL, at=[int(k) for k in shown], axis_notes=notes
    )
