r"""Control allocation over redundant actuators, and arrays of reaction wheels.

With the effects of the actuators in the columns of B, a command w requires outputs u with :math:`B u = w`. The
pseudo-inverse gives the u of least norm. "min-max" minimises the peak :math:`\max_i |u_i + \lambda n_i|`, B n = 0; at
the optimum two components have equal magnitude. "non-negative" minimises the sum of the outputs :math:`u \ge 0` for
each component and sign by linear programming.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias, get_args

import casadi as ca
import numpy as np
import scipy
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_float_array, read_variable_name
from gnc_opt.array_types import Array
from gnc_opt.errors import DesignError, quote_value, suggest_similar_name
from gnc_opt.numerical_tolerances import RANK
from gnc_opt.simulation.sensor_and_actuator_block import (
    Block,
    Defaults,
    Parameters,
    Step,
    StepContext,
    clip_and_propagate_nan,
    is_changed_by_clipping,
    read_block_values,
)

Method: TypeAlias = Literal["pseudo-inverse", "min-max", "non-negative"]
Balance: TypeAlias = Literal["none", "torque", "momentum"]


def pseudo_inverse(matrix: ArrayLike, failed: Sequence[int] = (), what: str = "the allocation") -> Array:
    """Return the pseudo-inverse (n, k) of the effects (k, n) of n actuators; rows of failed ones are zero.

    Raises
    ------
    DesignError
        The remaining actuators cannot produce every command; the message gives the direction and the singular value.
    """
    effects = read_effectiveness_matrix(matrix, failed, what)
    u, sizes, _ = np.linalg.svd(effects)
    rank = int(np.sum(sizes > RANK * float(sizes[0])))
    if rank < effects.shape[0]:
        smallest = float(sizes[rank]) if rank < sizes.size else 0.0
        loss = f" after the loss of {', '.join(map(str, failed))}" if len(failed) else ""
        raise DesignError(
            f"{what}: {effects.shape[1] - len(failed)} actuators{loss} span {rank} of {effects.shape[0]} directions, "
            f"no output along {np.round(u[:, -1], 4)} (singular value {smallest:.1e}): add actuators or command less."
        )
    inverse = np.asarray(np.linalg.pinv(effects))
    inverse[list(failed)] = 0.0
    return inverse


def find_null_space_vector(
    matrix: ArrayLike, failed: Sequence[int] = (), what: str = "the allocation"
) -> Array | None:
    """Return the outputs (n,) without effect, scaled to a largest entry of 1, or ``None`` if there are none.

    Raises
    ------
    DesignError
        The null space has more than one dimension.
    """
    effects = read_effectiveness_matrix(matrix, failed, what)
    intact = [i for i in range(effects.shape[1]) if i not in failed]
    basis = scipy.linalg.null_space(effects[:, intact], rcond=RANK)
    if basis.shape[1] == 0:
        return None
    if basis.shape[1] > 1:
        raise DesignError(
            f"{what} has {basis.shape[1]} null directions, but min-max allocation supports one: use the pseudo-inverse."
        )
    n = np.zeros(effects.shape[1])
    n[intact] = basis[:, 0] / basis[np.argmax(np.abs(basis[:, 0])), 0]
    return np.where(np.abs(n) < RANK, 0.0, n)


def minimise_actuator_effort(
    matrix: ArrayLike, sign: float, failed: Sequence[int] = (), what: str = "the allocation"
) -> Array:
    """Return the outputs >= 0 (n, k) of least sum for a unit command of the given sign along each component.

    Raises
    ------
    DesignError
        A component cannot be produced; the message names it.
    """
    effects = read_effectiveness_matrix(matrix, failed, what)
    columns = []
    for i, unit in enumerate(sign * np.eye(len(effects))):
        result = scipy.optimize.linprog(np.ones(effects.shape[1]), A_eq=effects, b_eq=unit, bounds=(0, None))
        if not result.success:
            raise DesignError(
                f"{what} cannot produce component {i} of its command with sign {'+' if sign > 0 else '-'} with outputs "
                ">= 0: add or turn thrusters, or reduce the command."
            )
        columns.append(result.x)
    return np.stack(columns, axis=1)


def minimise_peak_along_null_vector(u: Any, n: Array) -> Any:
    """Return the SX factor lambda for which the largest ``|u + lambda n|`` is smallest."""
    best, peak = ca.SX(0), ca.mmax(ca.fabs(u))
    for i, j in itertools.combinations(range(n.size), 2):
        for sign in (1.0, -1.0):
            slope = n[i] - sign * n[j]
            if abs(slope) < RANK:
                continue
            shift = -(u[i] - sign * u[j]) / slope
            value = ca.mmax(ca.fabs(u + shift * n))
            best, peak = ca.if_else(value < peak, shift, best), ca.if_else(value < peak, value, peak)
    return best


@dataclass(frozen=True)
class Allocation(Block):
    """Control allocation of a command to redundant actuators.

    Parameters
    ----------
    matrix : array (k, n)
        Effects of n actuators on k components of the command.
    to : str
        Name of the outputs, for the following blocks.
    method : {"pseudo-inverse", "min-max", "non-negative"}
        Least norm, smallest peak, or outputs >= 0 (one-directional thrusters) of least sum for commands along one
        component.
    failed : sequence of int
        Failed actuators; they are not used.
    unit : str
        Unit of the outputs.

    Raises
    ------
    DesignError
        The remaining actuators cannot produce every command.

    Examples
    --------
    >>> block = Allocation("two motors", [[1.0, 1.0]], to="motors", on="a")  # each gives half of it
    """

    matrix: ArrayLike
    to: str = "outputs"
    method: Method = "pseudo-inverse"
    failed: Sequence[int] = ()
    unit: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        read_variable_name(self.to, "signal")
        if self.method not in get_args(Method):
            raise DesignError(
                f"'{self.name}' cannot allocate by {quote_value(self.method)}: "
                f"{suggest_similar_name(str(self.method), get_args(Method))}"
            )
        self._allocate_command_to_actuators(ca.SX.zeros(np.shape(self.matrix)[0]))

    @property
    def is_memoryless(self) -> bool:
        return True

    def output_sizes(self, sizes: Mapping[str, int], units: Mapping[str, str]) -> dict[str, tuple[int, str]]:
        return {self.to: (np.shape(self.matrix)[1], self.unit)}

    def check_sizes(self, size: int, h: float, dt: float) -> None:
        check_effectiveness_matrix_rows(self.matrix, size, self.name)

    def step(self, tick: StepContext, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        return Step(self._allocate_command_to_actuators(signal), state)

    def _allocate_command_to_actuators(self, signal: Any) -> Any:
        arguments: tuple[Any, str] = self.failed, f"'{self.name}'"
        if self.method == "non-negative":
            plus, minus = (minimise_actuator_effort(self.matrix, sign, *arguments) for sign in (1.0, -1.0))
            positive = ca.if_else(signal < 0, 0.0, signal)
            return plus @ positive + minus @ (positive - signal)
        u = pseudo_inverse(self.matrix, *arguments) @ signal
        n = find_null_space_vector(self.matrix, *arguments) if self.method == "min-max" else None
        return u if n is None else u + minimise_peak_along_null_vector(u, n) * n


@dataclass(frozen=True)
class Mixer(Block):
    """Combined effect of actuators on the plant: ``matrix @ outputs``, split into controls.

    Parameters
    ----------
    matrix : array (k, n)
    to : str or mapping of str to int
        Name of the control, or names and sizes of several controls, in the order of the rows.
    unit : str

    Examples
    --------
    >>> from gnc_opt.simulation import Allocation, Mixer, Saturation
    >>> motors = [Allocation("share", [[1, 1]], to="motors", on="a"), Saturation("limit", -0.1, 0.1, on="motors")]
    >>> both = go.ClosedLoop(cart, regulator, [*motors, Mixer("sum", [[1, 1]], to="a", on="motors")])
    >>> flown = both.simulate([1.0, 0.0], tf=1.0)
    >>> print(f"{flown.control('a')(0.0)[0]:.3f}")  # as much as they can
    -0.200
    """

    matrix: ArrayLike
    to: str | Mapping[str, int] = "outputs"
    unit: str = ""

    @property
    def is_memoryless(self) -> bool:
        return True

    def output_sizes(self, sizes: Mapping[str, int], units: Mapping[str, str]) -> dict[str, tuple[int, str]]:
        rows = np.shape(self.matrix)[0]
        parts = {self.to: rows} if isinstance(self.to, str) else dict(self.to)
        if sum(parts.values()) != rows:
            raise DesignError(
                f"'{self.name}' has {rows} rows for {sum(parts.values())} components: give as many."
            )
        return {name: (size, self.unit) for name, size in parts.items()}

    def check_sizes(self, size: int, h: float, dt: float) -> None:
        columns = np.shape(self.matrix)[1]
        if columns != size:
            raise DesignError(f"'{self.name}' mixes {columns} outputs, but gets {size}.")

    def step(self, tick: StepContext, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        return Step(read_float_array(self.matrix, f"the matrix of '{self.name}'") @ signal, state)


def thruster_effects(positions: ArrayLike, directions: ArrayLike) -> Array:
    """Return forces (3 rows) and torques (3 rows) of thrusters at unit thrust, (6, n), for `Allocation` and `Mixer`.

    Parameters
    ----------
    positions, directions : array (3, n)
        Positions (m, relative to the centre of mass) and directions of the force on the body (normalised).

    Raises
    ------
    DesignError
        Inconsistent shapes, or a direction of zero length.

    Examples
    --------
    Four thrusters in a plane, with force along x and torque about z:

    >>> positions = [[0, 0, 0, 0], [1, -1, 1, -1], [0, 0, 0, 0]]
    >>> print(thruster_effects(positions, [[1, 1, -1, -1], [0, 0, 0, 0], [0, 0, 0, 0]])[[0, 5]])
    [[ 1.  1. -1. -1.]
     [-1.  1.  1. -1.]]
    """
    r, d = np.asarray(positions, dtype=float), np.asarray(directions, dtype=float)
    if r.ndim != 2 or r.shape != d.shape or r.shape[0] != 3:
        raise DesignError(
            f"thrusters have positions {r.shape} and directions {d.shape}: give (3, n) for both."
        )
    if not np.all(np.linalg.norm(d, axis=0) > 0):
        raise DesignError("a thruster has a direction of zero length: give the direction of its force.")
    d = d / np.linalg.norm(d, axis=0)
    return np.vstack([d, np.cross(r.T, d.T).T])


@dataclass(frozen=True)
class WheelArray(Block):
    r"""Reaction wheels: allocation, torque limits and momentum (speed) limits.

    A commanded body torque (3, N m) gives motor torques T with :math:`A T = T_{body}`; the wheel momenta obey
    :math:`\dot h = -T`. A torque that would exceed the momentum limit within a minor step is reduced.

    Parameters
    ----------
    axes : array (3, n)
        Spin axes as columns, body components.
    max_torque : float or one per wheel
        N m.
    max_momentum : float or one per wheel
        Wheel inertia times largest wheel speed, N m s.
    balance : {"none", "torque", "momentum"}
        Least norm of T, smallest peak torque, or smallest peak momentum.
    momenta : str, optional
        State of the plant that contains the wheel momenta (n); default: the block integrates them.
    to : str, optional
        Control of the plant that takes the motor torques (n); default: the body torque, named as the command.
    failed : sequence of int
        Failed wheels.
    initial : float or one per wheel
        Initial momenta, N m s, if the block integrates them.

    Raises
    ------
    DesignError
        The remaining wheels do not span all axes.

    Examples
    --------
    >>> from gnc_opt.spacecraft import wheel_pyramid
    >>> block = WheelArray("wheels", wheel_pyramid(), max_torque=0.2, max_momentum=4.0, on="T_B")
    """

    axes: ArrayLike
    max_torque: ArrayLike = math.inf
    max_momentum: ArrayLike = math.inf
    balance: Balance = "none"
    momenta: str | None = None
    to: str | None = None
    failed: Sequence[int] = ()
    initial: ArrayLike = field(default=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.balance not in get_args(Balance):
            raise DesignError(
                f"'{self.name}' cannot balance {quote_value(self.balance)}: "
                f"{suggest_similar_name(str(self.balance), get_args(Balance))}"
            )
        pseudo_inverse(self.axes, self.failed, f"wheel array '{self.name}'")
        if self.balance != "none":
            find_null_space_vector(self.axes, self.failed, f"wheel array '{self.name}'")

    @property
    def n_wheels(self) -> int:
        """Number of wheels."""
        return int(np.shape(self.axes)[1])

    def output_sizes(
        self, sizes: Mapping[str, int], units: Mapping[str, str]
    ) -> dict[str, tuple[int, str]] | None:
        return None if self.to is None else {self.to: (self.n_wheels, "N m")}

    def check_sizes(self, size: int, h: float, dt: float) -> None:
        check_effectiveness_matrix_rows(self.axes, size, self.name)

    def parameters(self, size: int, unit: str) -> Defaults:
        return {
            "max_torque": (
                read_block_values(self.max_torque, self.n_wheels, f"the torque limit of '{self.name}'"),
                "N m",
            ),
            "max_momentum": (
                read_block_values(self.max_momentum, self.n_wheels, f"the momentum limit of '{self.name}'"),
                "N m s",
            ),
            "momentum": (
                read_block_values(self.initial, self.n_wheels, f"the initial momenta of '{self.name}'"),
                "N m s",
            ),
            "health": (np.ones(self.n_wheels), ""),
        }

    def parameter_limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"max_torque": (0.0, math.inf), "max_momentum": (0.0, math.inf), "health": (0.0, 1.0)}

    def initial_memory(self, signal: Any, p: Parameters, tick: StepContext) -> Any:
        return ca.SX(0, 1) if self.momenta is not None else p["momentum"]

    def step(self, tick: StepContext, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        h_w = self._get_wheel_momenta(tick, state)
        torques = pseudo_inverse(self.axes, self.failed) @ signal
        n = None if self.balance == "none" else find_null_space_vector(self.axes, self.failed)
        if n is not None and self.balance == "torque":
            torques = torques + minimise_peak_along_null_vector(torques, n) * n
        elif n is not None:
            # h - T step: a null torque of -lambda / step shifts the momenta by lambda n
            shift = -minimise_peak_along_null_vector(h_w - torques * tick.h, n) / tick.h
            torques = torques + _limit_null_space_torque(shift, torques, n, p["max_torque"]) * n
        torque = clip_and_propagate_nan(torques, -p["max_torque"], p["max_torque"])
        torque = clip_and_propagate_nan(
            torque, (h_w - p["max_momentum"]) / tick.h, (h_w + p["max_momentum"]) / tick.h
        )
        # beyond its momentum limit a wheel is decelerated within its torque limit
        torque = clip_and_propagate_nan(torque, -p["max_torque"], p["max_torque"])
        saturated = is_changed_by_clipping(torque, torques)
        torque = torque * p["health"]
        after = state if self.momenta is not None else h_w - torque * tick.h
        return Step(torque if self.to is not None else np.asarray(self.axes) @ torque, after, saturated)

    def _get_wheel_momenta(self, tick: StepContext, state: Any) -> Any:
        if self.momenta is None:
            return state
        if self.momenta not in tick.x:
            raise DesignError(
                f"wheel array '{self.name}' looks for its momenta in state '{self.momenta}', which the plant does not "
                f"have: {suggest_similar_name(self.momenta, tick.x)}"
            )
        momenta = tick.x[self.momenta]
        if momenta.shape[0] != self.n_wheels:
            raise DesignError(
                f"state '{self.momenta}' holds {momenta.shape[0]} momenta for {self.n_wheels} wheels."
            )
        return momenta


def _limit_null_space_torque(shift: Any, torque: Any, n: Array, limit: Any) -> Any:
    """Return the shift along n, reduced so that all torques stay within their limits."""
    for i in range(n.size):
        if n[i] == 0:
            continue
        room_up = ca.fmax(0.0, limit[i] - torque[i]) / abs(n[i])
        room_down = ca.fmax(0.0, limit[i] + torque[i]) / abs(n[i])
        up, down = (room_up, room_down) if n[i] > 0 else (room_down, room_up)
        shift = clip_and_propagate_nan(shift, -down, up)
    return shift


def read_effectiveness_matrix(matrix: ArrayLike, failed: Sequence[int], what: str) -> Array:
    """Return the effects (k, n) as an array, with zero columns for failed actuators."""
    effects = read_float_array(matrix, f"the matrix of {what}", DesignError)
    if effects.ndim != 2 or not np.all(np.isfinite(effects)):
        raise DesignError(f"the matrix of {what} has the shape {effects.shape}: give finite numbers (k, n).")
    for i in failed:
        if not 0 <= i < effects.shape[1]:
            raise DesignError(f"{what} has no actuator {i}: it has 0 to {effects.shape[1] - 1}.")
        effects[:, i] = 0.0
    return effects


def check_effectiveness_matrix_rows(matrix: ArrayLike, size: int, name: str) -> None:
    """Raise an error if the size of the command differs from the rows of the matrix."""
    if np.shape(matrix)[0] != size:
        raise DesignError(f"'{name}' allocates {np.shape(matrix)[0]} components, but gets {size}.")
