"""View of a motion in space: position, attitude and force of a vehicle, sampled from a solution or a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_float_array
from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError, UnknownNameError, quote_value, unknown_name_error
from gnc_opt.model.model_variables import Layout, Variable
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.simulation.simulation_run_results import Run
from gnc_opt.spacecraft import mrp_to_dcm, quaternion_to_dcm

Moved: TypeAlias = Solution | Run
Names: TypeAlias = str | Sequence[str]

VEHICLE_HALF_EDGES = (0.36, 0.26, 0.26)
"""Edges of the box for a vehicle along its axes, in lengths of the drawn axes."""

AXIS, PLUME = 0.12, 0.2
"""Lengths of the body axes and of the plume at the largest force, as shares of the extent of the scene."""


@dataclass(frozen=True)
class View:
    """Definition of a 3-D view by the names of states and controls.

    A name is a whole variable (``"r"``) or one component (``"q[3]"``); several names form one vector.

    Attributes
    ----------
    position : str or sequence of str, optional
        One to three components x, y and z in frame L. None: the body stays at the origin.
    attitude : str or sequence of str, optional
        Attitude of body B relative to L: modified Rodrigues parameters (3) or a quaternion (4, scalar first).
    force : str or sequence of str, optional
        Resultant force, in B if there is an attitude, else in L; drawn as a plume.
    keep_out : mapping of str to (centre, radius)
        Spheres, or ellipsoids with three semi-axes along those of L, in the unit of the position.
    down : bool
        Whether z points downward in the figure (and y towards the viewer), for a z axis towards the planet.
    bodies : mapping of str to array (3,)
        Positions of other vehicles at rest in L, by name.

    Examples
    --------
    >>> view = View("q", force="a")
    """

    position: Names | None = None
    attitude: Names | None = None
    force: Names | None = None
    keep_out: Mapping[str, tuple[ArrayLike, ArrayLike]] = field(default_factory=dict)
    down: bool = False
    bodies: Mapping[str, ArrayLike] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.position is None and self.attitude is None:
            raise ArgumentError("a view has neither position nor attitude: give at least one.")
        for name in self.keep_out:
            self.keep_out_volume(name)
        for name, position in self.bodies.items():
            _read_position_vector(position, f"the position of '{name}'")

    def keep_out_volume(self, name: str) -> tuple[Array, Array]:
        """Return centre (3,) and semi-axes (3,) of a keep-out volume."""
        try:
            centre, radius = self.keep_out[name]
        except (TypeError, ValueError):
            raise ArgumentError(f"keep-out volume '{name}' is not a pair: give (centre, radius).") from None
        axes = read_float_array(radius, f"the radius of '{name}'").ravel()
        axes = (
            np.full(3, axes[0]) if axes.size == 1 else _read_position_vector(axes, f"the radius of '{name}'")
        )
        if not np.all(axes > 0):
            raise ArgumentError(f"the radius of '{name}' is {quote_value(radius)}: give a length > 0.")
        return _read_position_vector(centre, f"the centre of '{name}'"), axes


@dataclass(frozen=True)
class MotionSamples:
    """Samples at times (n,): position (3, n), body axes as rows (3, 3, n), force (3, n) relative to its largest.

    ``labels`` are the names of the axes, "" for axes without a component.
    """

    times: Array
    position: Array
    dcm_BL: Array | None
    force: Array | None
    unit: str
    labels: tuple[str, str, str]


def get_motion_time_span(moved: Moved, view: View) -> tuple[float, float]:
    """Return the start and end time (s) of a motion."""
    parts = _split_motion_into_phases(moved, view)
    return parts[0].begin, parts[-1].end


def sample_vehicle_motion(moved: Moved, view: View, times: Array) -> MotionSamples:
    """Return samples of a motion at times (n,), s; constant before its start and after its end."""
    parts = _split_motion_into_phases(moved, view)
    at = np.clip(times, parts[0].begin, parts[-1].end)
    begins = [part.begin for part in parts]
    owner = np.clip(np.searchsorted(begins, at, side="right") - 1, 0, len(parts) - 1)
    groups = [(part, at[owner == k]) for k, part in enumerate(parts) if np.any(owner == k)]

    def stack_motion_variables(names: Names) -> Array:
        return np.concatenate(
            [
                np.vstack([part.evaluate_motion_variable(n, t) for n in _list_motion_variable_names(names)])
                for part, t in groups
            ],
            axis=1,
        )

    position, unit, labels = np.zeros((3, times.size)), "", ("x", "y", "z")
    if view.position is not None:
        names, values = _list_motion_variable_names(view.position), stack_motion_variables(view.position)
        position = _pad_position_to_three_components(values, f"the position {', '.join(names)}")
        unit = parts[0].get_position_unit(names[0])
        if len(values) == 2:
            labels = names[0] if len(names) == 2 else "x", "", names[1] if len(names) == 2 else "y"
    dcm, force = None, None
    if view.attitude is not None:
        dcm = _compute_direction_cosine_matrix(
            stack_motion_variables(view.attitude), ", ".join(_list_motion_variable_names(view.attitude))
        )
    if view.force is not None:
        name = ", ".join(_list_motion_variable_names(view.force))
        force = _pad_position_to_three_components(stack_motion_variables(view.force), f"the force {name}")
        force = force / max(float(np.max(np.linalg.norm(force, axis=0))), np.finfo(float).tiny)
    return MotionSamples(times, position, dcm, force, unit, labels)


# --- sources ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _MotionPhase:
    begin: float
    end: float
    source: Any
    layouts: Mapping[str, Layout]

    def evaluate_motion_variable(self, name: str, t: Array) -> Array:
        """Return the values of a variable (size, n), or of one component (1, n)."""
        whole, bracket, _ = name.partition("[")
        values = np.atleast_2d(self._find_motion_variable(whole)(t))
        if not bracket:
            return values
        labels = Variable(whole, len(values)).labels
        if name not in labels:
            raise ArgumentError(f"{whole} has no component {name}: it has {', '.join(labels)}.")
        k = labels.index(name)
        return values[k : k + 1]

    def _find_motion_variable(self, name: str) -> Any:
        if name in self.layouts["state"]:
            return self.source.state(name)
        try:
            return self.source.control(name)  # composed controls are not in the layouts
        except UnknownNameError:
            known = [*self.layouts["state"].names, *self.layouts["control"].names]
            raise unknown_name_error("state or control", name, "the motion", known) from None

    def has_state_variables(self, names: Names) -> bool:
        return all(
            name.partition("[")[0] in self.layouts["state"] for name in _list_motion_variable_names(names)
        )

    def get_position_unit(self, name: str) -> str:
        return self.layouts["state"][name.partition("[")[0]].unit


def _split_motion_into_phases(moved: Moved, view: View) -> list[_MotionPhase]:
    if isinstance(moved, Run):
        layouts = {"state": moved.layouts["state"], "control": moved.layouts["applied"]}
        parts = [_MotionPhase(float(moved.times[0]), float(moved.times[-1]), moved, layouts)]
    else:
        parts = [
            _MotionPhase(
                phase.initial_time,
                phase.final_time,
                phase,
                {"state": phase.states, "control": phase.controls},
            )
            for phase in moved.phases.values()
        ]
    names = view.position if view.position is not None else view.attitude or ()
    found = [part for part in parts if part.has_state_variables(names)]
    if not found:  # say so in the words of what was given
        for name in _list_motion_variable_names(names):
            parts[0].source.state(name.partition("[")[0])
    return sorted(found, key=lambda part: part.begin)


def _list_motion_variable_names(names: Names) -> list[str]:
    return [names] if isinstance(names, str) else list(names)


# --- geometry -------------------------------------------------------------------------------------------


def sample_ellipsoid_surface(centre: Array, semi_axes: Array) -> Array:
    """Return points of an ellipsoid, (3, 13, 25), on meridians and parallels."""
    around, up = np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(-np.pi / 2, np.pi / 2, 13))
    unit = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
    return np.asarray(centre[:, None, None] + semi_axes[:, None, None] * unit)


def _pad_position_to_three_components(values: Array, what: str) -> Array:
    """Return three rows; the second of two components is drawn upward, as is a single one."""
    nothing = np.zeros(values.shape[1])
    if len(values) == 1:
        return np.vstack([nothing, nothing, values[0]])
    if len(values) == 2:
        return np.vstack([values[0], nothing, values[1]])
    if len(values) != 3:
        raise ArgumentError(f"{what} has {len(values)} components: one to three can be drawn.")
    return values


def _compute_direction_cosine_matrix(attitude: Array, name: str) -> Array:
    kinds = {3: mrp_to_dcm, 4: quaternion_to_dcm}
    if len(attitude) not in kinds:
        raise ArgumentError(
            f"the attitude {name} has {len(attitude)} components: give modified Rodrigues parameters (3) or a "
            "quaternion (4)."
        )
    return np.asarray(kinds[len(attitude)](attitude), dtype=float)


def _read_position_vector(value: ArrayLike, what: str) -> Array:
    numbers = read_float_array(value, what).ravel()
    if numbers.size != 3 or not np.all(np.isfinite(numbers)):
        raise ArgumentError(f"{what} is {quote_value(value)}: give three finite numbers.")
    return numbers
