"""Figures of solutions: over time and in space; none opens a window."""

from gnc_opt.plot.path import plot_curves, plot_path
from gnc_opt.plot.style import save_figure
from gnc_opt.plot.trajectory import plot_controls, plot_costates, plot_hamiltonian, plot_states
from gnc_opt.plot.verdict import plot_verdict

__all__ = [
    "plot_controls",
    "plot_costates",
    "plot_curves",
    "plot_hamiltonian",
    "plot_path",
    "plot_states",
    "plot_verdict",
    "save_figure",
]
