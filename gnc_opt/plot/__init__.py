"""Figures of solutions, runs and campaigns over time and in space; no window is opened."""

from functools import partial

from gnc_opt.plot.campaign_figures import plot_dispersion, plot_distributions, plot_envelope
from gnc_opt.plot.control_figures import plot_controls
from gnc_opt.plot.figure_style import save_figure
from gnc_opt.plot.frequency_response_figures import plot_response
from gnc_opt.plot.simulation_run_figure import plot_run
from gnc_opt.plot.trajectory_figure_3d import plot_motion
from gnc_opt.plot.trajectory_figures import (
    plot_costates,
    plot_hamiltonian,
    plot_path_constraints,
    plot_states,
)
from gnc_opt.plot.vehicle_motion_sampling import View
from gnc_opt.renamed_public_names import raise_missing_name_error

__all__ = [
    "View",
    "plot_controls",
    "plot_costates",
    "plot_dispersion",
    "plot_distributions",
    "plot_envelope",
    "plot_hamiltonian",
    "plot_motion",
    "plot_path_constraints",
    "plot_response",
    "plot_run",
    "plot_states",
    "save_figure",
]

__getattr__ = partial(raise_missing_name_error, __name__)
