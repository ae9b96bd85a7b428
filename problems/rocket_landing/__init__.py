"""Rocket landing: Mars landing in wind with re-planning in flight, compared with a published law.

    python -m problems.rocket_landing [--runs N] [--seed S] [--json OUT] [--checkpoint DIR]

Read the files in this order:

* `model`: the lander, its plan, the plant;
* `control`: the regulator about the plan, the published controller, the closed loops, and the dispersions.
"""

from problems.rocket_landing.control import CONTROLLERS, DISPERSIONS, LATEST, LIMITS, Landing, resolver
from problems.rocket_landing.model import START, build, descent, plant
