"""A tethered pair of satellites: swing and orbit by the direction of the leader's thrust.

The swing is taken out in the least time and with the least effort, and the manoeuvres are tracked, by a published
control structure among others. The numbers that are known of it are reproduced by
``python -m benchmarks.validation.published tethered_formation``. The page is docs/tethered_formation.md.

Read the files in this order:

* `tether`: equations of motion; `model`: data, dynamics, the reference orbit;
* `optimal`: the optimal control problems and their solutions;
* `predictive_reaching`: the published reaching law; `control`: the published structure (surface, observer, reaching
  laws), and following a plan.
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
