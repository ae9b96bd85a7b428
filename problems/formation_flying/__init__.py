"""Formation flying with J2: a follower joins a circle of 1 km radius around its leader.

The plans have minimum Delta-V or minimum time. A published controller, the optimal sliding mode, tracks them.
``python -m benchmarks.validation.published formation_flying`` compares the results with the publication.

Read the files in this order:

* `model`: data, the dynamics in the leader's frame, the formation;
* `optimal`: least Delta-V and least time;
* `control`: the published controllers, and tracking of a plan.
"""

from problems.formation_flying.model import build_model
from problems.formation_flying.optimal import REFERENCE, build, build_fast
