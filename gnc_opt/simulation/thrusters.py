"""Thrusters: they only push, so a command is distributed by non-negative thrusts.

The cheapest thrusts of every unit command are found by linear programming and superposed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
import scipy
from numpy.typing import ArrayLike

from gnc_opt.arrays import Array
from gnc_opt.errors import DesignError
from gnc_opt.simulation.allocation import Mixer, check_rows, effect_matrix
from gnc_opt.simulation.block import Block, Parameters, Step, Tick


@dataclass(frozen=True)
class NonNegativeAllocation(Block):
    """Distributes a command over actuators that only push.

    Each command is the sum of its positive and negative components; the outputs of least sum for each are
    found by linear programming. The sum is least for commands along one component, and feasible for all.

    Parameters
    ----------
    matrix : array (k, n)
    to : str
    unit : str

    Raises
    ------
    DesignError
        A component cannot be produced; the message names it.

    Examples
    --------
    >>> block = NonNegativeAllocation("nozzles", [[1.0, -1.0]], to="thrusts", unit="m/s^2", on="a")
    """

    matrix: ArrayLike
    to: str = "thrusts"
    unit: str = ""
    _plus: Array = field(init=False, repr=False, compare=False)
    _minus: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        matrix = effect_matrix(self.matrix, (), f"'{self.name}'")
        for label, sign in (("_plus", 1.0), ("_minus", -1.0)):
            columns = [self._cheapest(matrix, i, sign) for i in range(matrix.shape[0])]
            object.__setattr__(self, label, np.stack(columns, axis=1))

    def _cheapest(self, matrix: Array, i: int, sign: float) -> Array:
        unit = np.zeros(matrix.shape[0])
        unit[i] = sign
        found = scipy.optimize.linprog(
            np.ones(matrix.shape[1]), A_eq=matrix, b_eq=unit, bounds=(0, None), method="highs"
        )
        if not found.success:
            raise DesignError(
                f"'{self.name}' cannot produce component {i} of its command with sign {'+' if sign > 0 else '-'} by "
                "pushing alone: add thrusters, turn them, or command less."
            )
        return np.asarray(found.x)

    @property
    def memoryless(self) -> bool:
        return True

    def outputs(self, sizes: Mapping[str, int], units: Mapping[str, str]) -> dict[str, tuple[int, str]]:
        return {self.to: (np.shape(self.matrix)[1], self.unit)}

    def check(self, size: int, h: float, dt: float) -> None:
        check_rows(self.matrix, size, self.name)

    def step(self, tick: Tick, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        positive = ca.if_else(signal < 0, 0.0, signal)
        return Step(self._plus @ positive + self._minus @ (positive - signal), state)


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
    ) -> NonNegativeAllocation:
        """Return the block that turns commanded force (N) and torque (N m) into thrusts >= 0 (N)."""
        rows = self._rows(force, torque)
        on = tuple(n for n in (force, torque) if n is not None)
        return NonNegativeAllocation(name, self.effects[rows], to, unit="N", on=on)

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
