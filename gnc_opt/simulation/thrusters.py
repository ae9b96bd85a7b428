"""Thrusters fixed in a body: their effects, the block that allocates to them and the one that adds up what they do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arrays import Array
from gnc_opt.errors import DesignError
from gnc_opt.simulation.allocation import Allocation, Mixer


@dataclass(frozen=True)
class ThrusterSet:
    """Thrusters fixed in a body: the blocks that allocate to them and that add up what they do.

    Parameters
    ----------
    positions, directions : array (3, n)
        Where they push (m, relative to the centre of mass) and in which direction they push the body (normalised).

    Raises
    ------
    DesignError
        Shapes that do not fit, or a direction of zero length.

    Examples
    --------
    Four thrusters in a plane that push a body along x and turn it about z:

    >>> positions = [[0, 0, 0, 0], [1, -1, 1, -1], [0, 0, 0, 0]]
    >>> thrusters = ThrusterSet(positions, [[1, 1, -1, -1], [0, 0, 0, 0], [0, 0, 0, 0]])
    >>> print(thrusters.effects[[0, 5]])  # force along x and torque about z of each
    [[ 1.  1. -1. -1.]
     [-1.  1.  1. -1.]]
    """

    positions: ArrayLike
    directions: ArrayLike

    def __post_init__(self) -> None:
        r, d = np.asarray(self.positions, dtype=float), np.asarray(self.directions, dtype=float)
        if r.ndim != 2 or r.shape != d.shape or r.shape[0] != 3:
            raise DesignError(
                f"thrusters have positions {r.shape} and directions {d.shape}: give (3, n) for both."
            )
        if not np.all(np.linalg.norm(d, axis=0) > 0):
            raise DesignError("a thruster has a direction of zero length: give where it pushes.")

    @property
    def effects(self) -> Array:
        """Force (3 rows) and torque (3 rows) of each thruster at unit thrust, (6, n)."""
        d = np.asarray(self.directions, dtype=float)
        d = d / np.linalg.norm(d, axis=0)
        return np.vstack([d, np.cross(np.asarray(self.positions, dtype=float).T, d.T).T])

    def allocation(
        self, name: str, *, force: str | None = None, torque: str | None = None, to: str = "thrusts"
    ) -> Allocation:
        """Return the block that turns commanded force (N) and torque (N m) into thrusts >= 0 (N)."""
        rows = self._rows(force, torque)
        on = tuple(n for n in (force, torque) if n is not None)
        return Allocation(name, self.effects[rows], to, "non-negative", unit="N", on=on)

    def mixer(
        self, name: str, *, force: str | None = None, torque: str | None = None, thrusts: str = "thrusts"
    ) -> Mixer:
        """Return the block that turns thrusts (N) into the plant's force (N) and torque (N m)."""
        rows = self._rows(force, torque)
        return Mixer(name, self.effects[rows], {n: 3 for n in (force, torque) if n is not None}, on=thrusts)

    def _rows(self, force: str | None, torque: str | None) -> list[int]:
        if force is None and torque is None:
            raise DesignError("thrusters without a force and a torque to produce: name at least one control.")
        return [*([0, 1, 2] if force else []), *([3, 4, 5] if torque else [])]
