"""Figure of a refinement: the mesh of each iteration."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from gnc_opt.planning.solution.history import History
from gnc_opt.plot.style import apply_style, new_figure

_COLORMAP = "viridis_r"


def plot_refinement(history: History) -> Figure:
    """Return a figure of the meshes: one row of segments over time per iteration, coloured by degree.

    Parameters
    ----------
    history : History

    Examples
    --------
    >>> figure = plot_refinement(solution.history)
    """
    degrees = [n for p in history.passes for mesh in p.meshes.values() for n in mesh.degrees]
    norm = Normalize(min(degrees), max(max(degrees), min(degrees) + 1))
    with apply_style():
        figure = new_figure(1.4 + 0.17 * len(history.passes))
        ax = figure.subplots()
        for i, record in enumerate(history.passes):
            for phase, mesh in record.meshes.items():
                times = np.array(record.times[phase])
                colours = colormaps[_COLORMAP](norm(mesh.degrees))
                look = {"color": colours, "edgecolor": "white", "linewidth": 0.4}
                ax.barh(np.full(mesh.segments, i), np.diff(times), left=times[:-1], height=0.8, **look)
        ax.margins(x=0.0)
        ax.set(xlabel="time", ylabel="iteration", ylim=(len(history.passes) - 0.5, -0.5))
        ax.yaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        ax.grid(False)
        ticks = MaxNLocator(3, integer=True)
        figure.colorbar(ScalarMappable(norm, _COLORMAP), ax=ax, label="degree", pad=0.01, ticks=ticks)
    return figure
