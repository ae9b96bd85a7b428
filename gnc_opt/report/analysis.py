"""Tables of analyses: linear covariances with their sources."""

from __future__ import annotations

import numpy as np

from gnc_opt.analysis.covariance import LINEAR, LinearCovariance

_SOURCES = 3
"""That are told of each state."""


def covariance_table(found: LinearCovariance) -> str:
    """Return the standard deviations at the end as text: a line per state, with its main sources."""
    layout = found.layouts["error"]
    width = max([5, *map(len, layout.names)])
    units = max([1, *(len(v.unit) for v in layout.variables)])
    lines = [
        f"linear covariance over {found.times[-1] - found.times[0]:g} s, {len(found.sources)} sources",
        f"  {'at the end':{width + units + 1}}  1 sigma   "
        + ("nonlinear  " if found.checked else "")
        + "sources",
    ]
    for variable in layout.variables:
        sigma = float(np.linalg.norm(found.std(variable.name)[:, -1]))
        line = f"  {variable.name:{width}} {variable.unit:{units}}  {sigma:<8.3g}  "
        if found.checked:
            line += f"{_percent(float(np.max(found.nonlinearity(variable.name)[:, -1]))):<9}  "
        shares = [(s, share) for s, share in found.budget(variable.name).items() if share > 0][:_SOURCES]
        lines.append((line + ", ".join(f"{s} {_percent(share)}" for s, share in shares)).rstrip())
    if found.checked:
        bent = [name for name in layout.names if not found.linear(name)]
        verdict = f"not linear: {', '.join(bent)}" if bent else f"all linear, to {_percent(LINEAR)} of sigma"
        lines.append(
            f"  {verdict} ({found.checked} runs beside their predictions); sources: shares of the variance"
        )
    return "\n".join(lines)


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.995 else f"{100 * share:.0f} %"
