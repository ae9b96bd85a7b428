r"""How much of its curvature in a control H keeps over a span: rounded kinks do not keep it, and rounding is none.

A kink that is rounded, as :math:`\sqrt{u^2 + e^2}` for :math:`|u|`, curves as :math:`1 / e` and is worth no more than
the kink. Where costates are rounding, H does not change over a span as its curvature foretells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gnc_opt.arrays import Array, Indices
from gnc_opt.problem.functions import PhaseFunctions
from gnc_opt.solution.spans import FORETOLD, IDLE

_KEPT = 10.0
"""Times what H bends by over half of a control's span its curvature there may amount to."""


@dataclass(frozen=True, eq=False)
class Bending:
    """H along a phase, with other controls.

    Attributes
    ----------
    functions : PhaseFunctions
    times, x, u, lam : array (n_samples,), (n_states, n_samples), (n_controls, n_samples), (n_states, n_samples)
    curvature : array (n_controls, n_samples)
        d2H/du2 of each control by itself.
    """

    functions: PhaseFunctions
    times: Array
    x: Array
    u: Array
    lam: Array
    curvature: Array

    def lasting(self, i: int, at: Indices, span: float) -> Array:
        """Share of its curvature in a control that H may keep over half of a span to either side, at some samples."""
        kept = self._kept(i, at, span)
        return np.asarray(np.where(np.isfinite(kept), np.minimum(_KEPT * kept, 1.0), 1.0))

    def rounding(self, spans: Array) -> Indices:
        """Controls that move by nothing beside spans (n_controls,) that H's curvature asks for but does not keep."""
        beyond = np.flatnonzero(spans * IDLE >= np.ptp(self.u, axis=1))
        return beyond[[not self._bends(int(i), spans[i]) for i in beyond]]

    def _bends(self, i: int, span: float) -> bool:
        """Whether H changes over a control's span by a fair share of what its largest curvature foretells."""
        at = np.array([np.argmax(np.abs(np.nan_to_num(self.curvature[i])))])
        kept = self._kept(i, at, span)[0]
        return bool(not np.isfinite(kept) or kept >= FORETOLD)

    def _kept(self, i: int, at: Indices, span: float) -> Array:
        """Share of its curvature in a control that H has over half of a span to either side, at some samples."""
        step = np.zeros((self.u.shape[0], 1))
        step[i] = 0.5 * span
        t, x, lam, u = self.times[at], self.x[:, at], self.lam[:, at], self.u[:, at]
        before, here, after = (self.functions.hamiltonian(t, x, v, lam) for v in (u - step, u, u + step))
        foretold = np.abs(self.curvature[i, at]) * step[i, 0] ** 2
        bend = np.abs(after - 2.0 * here + before)
        return np.asarray(np.divide(bend, foretold, out=np.ones_like(foretold), where=foretold > 0))
