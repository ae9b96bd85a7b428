"""A tethered pair of satellites: swing and orbit by the direction of the leader's thrust.

The published control structure is reproduced; the same swing is then taken out in the least time and with the least
effort, and both manoeuvres are tracked. The page is docs/tethered_formation.md.

To be read in this order:

* `model`: data, dynamics, the reference orbit;
* `laws`: the published structure: surface, observer, reaching laws; `runs`: its closed loop;
* `published`: every number that is known of it, against ours;
* `optimal`: the optimal control problems, their solutions and tracking;
* `flown`: optima and published structure on the same disturbed plant;
* `plots`, `report`: what is drawn and printed.
"""

from problems.tethered_formation.model import (
    DURATION,
    FIRST_SWING,
    FORCE,
    MAX_ANGLE,
    MAX_RATE,
    PAIR,
    RADIUS,
    RATE,
    Gravity,
    Orbit,
    equilibrium,
    first_state,
    reference,
    tether_model,
)
from problems.tethered_formation.optimal import MESH, REFERENCE, Goal, build, solve
from problems.tethered_formation.report import main

__all__ = [
    "DURATION",
    "FIRST_SWING",
    "FORCE",
    "MAX_ANGLE",
    "MAX_RATE",
    "MESH",
    "PAIR",
    "RADIUS",
    "RATE",
    "REFERENCE",
    "Goal",
    "Gravity",
    "Orbit",
    "build",
    "equilibrium",
    "first_state",
    "main",
    "reference",
    "solve",
    "tether_model",
]
