"""Controls that minimise H along a trajectory, the initial guess of a second solve from a false extremal.

A collocation program may converge to controls at which H is stationary but not minimal, since its derivatives are
local. If the states are nearly optimal, so are the costates; the controls that minimise H along them lead from the
local to the global minimum of H.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.verification.hamiltonian_minimum import minimise_hamiltonian


def guess_by_minimum_hamiltonian(solution: Solution) -> Solution:
    """Return a guess with the controls that minimise H along the states and costates of a solution."""
    phases = {name: _minimise_phase_hamiltonian(s) for name, s in solution.samples().items()}
    return replace(solution, phases=phases)


def _minimise_phase_hamiltonian(s: PhaseSamples) -> PhaseSolution:
    if not s.leg.controls.size:
        return s.leg
    times, controls = minimise_hamiltonian(s)
    nearest = np.argmin(np.abs(times[:, None] - s.leg.point_times), axis=0)
    return replace(s.leg, u=s.leg.interpolate_points(controls[:, nearest]))
