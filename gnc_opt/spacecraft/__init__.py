"""Spacecraft dynamics, symbolic and numeric alike: attitude, rigid body, relative orbit."""

from gnc_opt.spacecraft.attitude import (
    mrp_from_axis_angle,
    mrp_rate,
    mrp_shadow,
    mrp_short,
    mrp_to_dcm,
    mrp_to_euler,
    mrp_to_quaternion,
    mrp_to_rotation,
)
from gnc_opt.spacecraft.relative_orbit import (
    MU_EARTH,
    RADIUS_EARTH,
    hill_acceleration,
    lvlh_rate,
    mean_motion,
)
from gnc_opt.spacecraft.rigid_body import (
    angular_acceleration,
    angular_momentum,
    divide_by_inertia,
    relative_angular_acceleration,
)
from gnc_opt.spacecraft.vector import apply, cross, dot, scale, stack, stack_rows, transpose

__all__ = [
    "MU_EARTH",
    "RADIUS_EARTH",
    "angular_acceleration",
    "angular_momentum",
    "apply",
    "cross",
    "divide_by_inertia",
    "dot",
    "hill_acceleration",
    "lvlh_rate",
    "mean_motion",
    "mrp_from_axis_angle",
    "mrp_rate",
    "mrp_shadow",
    "mrp_short",
    "mrp_to_dcm",
    "mrp_to_euler",
    "mrp_to_quaternion",
    "mrp_to_rotation",
    "relative_angular_acceleration",
    "scale",
    "stack",
    "stack_rows",
    "transpose",
]
