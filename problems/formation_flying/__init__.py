"""Formation flying with oblateness: sliding mode against optimal sliding mode as published, and the optimum.

A follower joins a circle of 1 km radius around its leader. The publication compares two laws by four
numbers, which are reproduced; the same formation is then reached with the least Delta-V and in the least
time, and plans and law are flown under the same conditions. The page is docs/formation_flying.md.

To be read in this order:

* `model`: data, the dynamics in the leader's frame and in inertial space, the formation;
* `laws`: the published laws and their runs;
* `published`: the publication's numbers against ours;
* `optimal`: least Delta-V and least time;
* `flown`: both plans and the published law on the same disturbed plant;
* `plots`, `report`: what is drawn and printed.
"""

from problems.formation_flying.model import build_model
from problems.formation_flying.optimal import REFERENCE, build, build_fast
from problems.formation_flying.report import comparison, main

__all__ = ["REFERENCE", "build", "build_fast", "build_model", "comparison", "main"]
