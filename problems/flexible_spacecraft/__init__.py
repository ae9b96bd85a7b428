"""Attitude slews of a flexible spacecraft: in the least time, and with the least vibration.

A hub with four appendage modes turns by 143 degrees under a torque limit of 0.5 N m and ends at rest, with no modal
energy left. The slews are tracked, by a regulator and by a published quasi-sliding-mode controller. The numbers of the
publication are reproduced by ``python -m benchmarks.validation.published flexible_spacecraft``. The page is
docs/flexible_spacecraft.md.

Read the files in this order:

* `model`: data and dynamics;
* `optimal`: least time, least time and effort, least vibration;
* `control`: the quasi-sliding mode, the regulator along a slew, and their closed loop.
"""

from problems.flexible_spacecraft.control import quasi_sliding_mode
from problems.flexible_spacecraft.model import build_model
from problems.flexible_spacecraft.optimal import REFERENCE, build, build_gentle
