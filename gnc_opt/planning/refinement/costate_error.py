"""How far the costates are from their differential equation between the nodes.

The residual of a segment is the integral of |d(lambda)/dt + dH_a/dx + z|, times the state's magnitude over
the cost's. Segments with an active constraint of the states alone are left out: costates may jump there.
"""

from __future__ import annotations

import numpy as np

from gnc_opt.arrays import Array, Mask
from gnc_opt.planning.solution.samples import PhaseSamples

COSTATE_ERROR_WEIGHT = 20.0
"""A residual r counts as an error of (20 r)^2: costates affect the cost in second order only."""

ACTIVE_MULTIPLIER_SHARE = 1e-6
"""A multiplier of this share of H, or an impulse of this share of the cost, says that a constraint is active."""


def adjoint_density(samples: PhaseSamples, pure_paths: Array) -> Array:
    """Return the residual (n_states, n_samples) in shares of the cost per second; zero where it does not count.

    Parameters
    ----------
    samples : PhaseSamples
    pure_paths : array (n_paths,)
        Magnitude of each path constraint that depends on the states alone; 0 for the others.
    """
    s = samples
    residual = s.lam_rate - costate_rates(s, s.times, s.x, s.u, s.sample(s.leg.lam))
    counts = unconstrained(s, pure_paths)[s.segments]
    return np.where(counts, np.abs(residual) * costate_worth(s)[:, None], 0.0)


def costate_rates(samples: PhaseSamples, times: Array, x: Array, u: Array, lam: Array) -> Array:
    """Return -dH_a/dx - z along a trajectory, (n_states, n_times)."""
    leg = samples.leg
    mu = leg.path_multiplier(times) if leg.path_labels else np.zeros((0, times.size))
    rates = -samples.functions.state_gradient(times, x, u, lam, mu)
    return rates - leg.state_multiplier(times) if np.any(leg.state_multipliers) else rates


def costate_worth(samples: PhaseSamples) -> Array:
    """Return the change of the cost by a change of each costate, as a share of the cost, (n_states,)."""
    return samples.state_scale / samples.cost_scale


def unconstrained(samples: PhaseSamples, pure_paths: Array) -> Mask:
    """Return in which segments (K,) no constraint of the states alone is active, neither inside nor at the ends."""
    leg = samples.leg
    forces = np.concatenate(
        [
            np.abs(leg.state_multipliers) * samples.state_scale[:, None],
            np.abs(leg.path_multipliers) * pure_paths[:, None],
        ]
    )
    pushed = np.any(forces > ACTIVE_MULTIPLIER_SHARE * samples.hamiltonian_scale, axis=0)
    jumps = np.any(
        np.abs(leg.state_impulses) * costate_worth(samples)[:, None] > ACTIVE_MULTIPLIER_SHARE, axis=0
    )
    jumps[[0, -1]] = False  # the ends of a phase have boundary conditions
    held = np.logical_or.reduceat(pushed, leg.mesh.offsets[:-1])
    return np.asarray(~(held | jumps[:-1] | jumps[1:]))
