"""The tube around the mean path of many runs that holds a stated share of them."""

from __future__ import annotations

import numpy as np

from gnc_opt.arrays import Array

SHARE = 0.95
"""Of the runs."""
_ROUND = 25
"""Points around the tube, the first one twice."""
_FLAT = 1e-6
"""Least half width, share of the extent of the mean path: motion in a plane has a tube as flat as this."""


def tube(positions: Array, share: float = SHARE) -> Array:
    """Return points of the tube at each instant, (3, n_times, 25).

    Each section lies across the mean path and is the ellipse of the covariance of the runs' deviations there,
    enlarged until it holds the share: no distribution is assumed. Deviations along the path do not show.

    Parameters
    ----------
    positions : array (n_runs, 3, n_times)
        Of the runs at the same instants, finite.
    share : float
        Of the runs within each section, in (0, 1].

    Returns
    -------
    array (3, n_times, 25)
    """
    mean = positions.mean(axis=0)
    least = _FLAT * max(float(np.max(np.ptp(mean, axis=1))), np.finfo(float).tiny)
    angle = np.linspace(0.0, 2.0 * np.pi, _ROUND)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    sections = []
    for k, across in enumerate(_across(mean)):
        deviations = across @ (positions[:, :, k] - mean[:, k]).T  # (2, n_runs)
        variances, directions = np.linalg.eigh(deviations @ deviations.T / deviations.shape[1])
        widths = np.sqrt(np.maximum(variances, least**2))
        distances = np.linalg.norm(directions.T @ deviations / widths[:, None], axis=0)
        reach = float(np.quantile(distances, share, method="higher"))
        root = directions @ (
            widths[:, None] * directions.T
        )  # symmetric: sections do not turn from one to the next
        sections.append(mean[:, [k]] + reach * across.T @ root @ circle)
    return np.stack(sections, axis=1)


def _across(mean: Array) -> list[Array]:
    """Return two unit vectors across the path at each instant, (2, 3), that turn as little as they can along it."""
    steps = np.gradient(mean, axis=1)
    speeds = np.linalg.norm(steps, axis=0)
    moving = np.flatnonzero(speeds > 1e-9 * max(float(speeds.max()), np.finfo(float).tiny))
    found: list[Array] = []
    first = np.eye(3)[0]
    for k in range(mean.shape[1]):
        near = (
            moving[np.argmin(np.abs(moving - k))] if moving.size else None
        )  # at rest: as it came or will go
        along = np.array([0.0, 0.0, 1.0]) if near is None else steps[:, near] / speeds[near]
        first = first - (first @ along) * along
        if np.linalg.norm(first) < 0.1:
            axis = np.eye(3)[int(np.argmin(np.abs(along)))]
            first = axis - (axis @ along) * along
        first = first / np.linalg.norm(first)
        found.append(np.stack([first, np.cross(along, first)]))
    return found
