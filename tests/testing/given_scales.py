"""Reference magnitudes that tests give, in the place of measured ones."""

from __future__ import annotations

from typing import Any

import numpy as np

from testing.internals import BoundaryChanges, Ellipsoid, PhaseSamples, PhaseScales, Scales


def given_scales(
    samples: list[PhaseSamples],
    cost: float = 1.0,
    radius: float = 1.0,
    deviation: float = 1.0,
    parameters: Any = (),
    constraints: Any = ((), (), ()),
) -> Scales:
    """Return scales of uncorrelated states that all have one radius, and of controls that all have one deviation."""
    phases = {}
    for s in samples:
        n, m = s.x.shape[0], s.u.shape[0]
        ball = Ellipsoid(np.full(n, radius), np.eye(n), np.ones(n))
        widths = np.full((m, s.times.size), deviation)
        phases[s.phase.name] = PhaseScales(widths, ball, ball, ball, np.full(m, cost))
    ends: Any = None
    states = 2 * sum(s.x.shape[0] for s in samples)
    reach, bends, terms = (
        np.append(row, np.full(states, v)) for row, v in zip(constraints, (radius, 0.0, 0.0), strict=True)
    )
    boundary = {1.0: BoundaryChanges(np.diag(reach**2), bends, terms)}
    return Scales(phases, cost, cost, np.asarray(parameters, dtype=float), ends, {}, {}, boundary)
