"""Tethered satellites: control of swing and orbit by the direction of the leader's thrust.

The optimal manoeuvres remove the swing in minimum time or with minimum effort. A published controller and others track
them. ``python -m benchmarks.validation.published tethered_formation`` compares the results with the publication.

Read the files in this order:

* `tether`: equations of motion; `model`: data, dynamics, the reference orbit;
* `optimal`: the optimal control problems and their solutions;
* `predictive_reaching`: the published reaching law; `control`: the published structure (surface, observer, reaching
  laws), and tracking of a plan.
"""

from problems.tethered_formation.model import (
    DURATION,
    FORCE,
    MAX_ANGLE,
    PAIR,
    RADIUS,
    Orbit,
    first_state,
    reference,
    tether_model,
)
from problems.tethered_formation.optimal import MESH, REFERENCE, build
