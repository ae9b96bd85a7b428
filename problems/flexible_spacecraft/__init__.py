"""Flexible spacecraft: attitude slews in minimum time and with minimum vibration.

A hub with four appendage modes turns by 143 degrees under a torque limit of 0.5 N m and ends at rest without modal
energy. A regulator and a published quasi-sliding-mode controller track the slews.
``python -m benchmarks.validation.published flexible_spacecraft`` compares the results with the publication.

Read the files in this order:

* `model`: data and dynamics;
* `optimal`: least time, least time and effort, least vibration;
* `control`: the quasi-sliding mode, the regulator along a slew, and their closed loop.
"""

from problems.flexible_spacecraft.control import quasi_sliding_mode
from problems.flexible_spacecraft.model import build_model
from problems.flexible_spacecraft.optimal import REFERENCE, build, build_gentle
