"""Attitude control of a flexible spacecraft: quasi-sliding mode as published, and the same slew made optimal.

The publication turns a hub with four appendage modes by 143 degrees under a torque limit of 0.5 N m. Its numbers are
reproduced as far as they can be; the slew is done in the least time and with the least vibration, no modal energy left
at the end, and tracked. The page is docs/flexible_spacecraft.md.

To be read in this order:

* `model`: data and dynamics; `plant`: facts of the dynamics, checked;
* `laws`: the quasi-sliding-mode law; `runs`: its closed loop, and what is measured of a run;
* `published`: the publication's numbers against ours; `studies`: what the law itself does;
* `optimal`: least time and least vibration, and their tracking;
* `flown`: both beside the published law, at equal torque and at equal effort;
* `plots`, `report`: what is drawn and printed.
"""

from problems.flexible_spacecraft.laws import quasi_sliding_mode
from problems.flexible_spacecraft.model import build_model
from problems.flexible_spacecraft.optimal import REFERENCE, build, build_gentle
from problems.flexible_spacecraft.report import comparison, main

__all__ = ["REFERENCE", "build", "build_gentle", "build_model", "comparison", "main", "quasi_sliding_mode"]
