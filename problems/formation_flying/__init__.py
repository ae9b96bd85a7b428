"""Formation flying with oblateness: a follower joins a circle of 1 km radius around its leader.

With the least Delta-V and in the least time, and tracked by a published controller, the optimal sliding mode. The
numbers of the publication are reproduced by ``python -m benchmarks.validation.published formation_flying``. The page is
docs/formation_flying.md.

Read the files in this order:

* `model`: data, the dynamics in the leader's frame, the formation;
* `optimal`: least Delta-V and least time;
* `control`: the published controllers, and tracking of a plan.
"""

from problems.formation_flying.model import build_model
from problems.formation_flying.optimal import REFERENCE, build, build_fast
