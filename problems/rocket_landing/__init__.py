"""A rocket lands on Mars in wind, its plan made again in flight, beside a published law.

    python -m problems.rocket_landing [--runs N] [--seed S] [--json OUT] [--checkpoint DIR]

To be read in this order:

* `model`: the lander, its plan, the plant;
* `laws`: the regulator about the plan, and the published law;
* `flown`: the loops, what runs differ by, how they are judged;
* `table`: what is printed.
"""

from problems.rocket_landing.flown import CONTROLLERS, DISPERSIONS, LATEST, LIMITS, Landing, resolver
from problems.rocket_landing.model import START, build, descent, plant
from problems.rocket_landing.table import main

__all__ = [
    "CONTROLLERS",
    "DISPERSIONS",
    "LATEST",
    "LIMITS",
    "START",
    "Landing",
    "build",
    "descent",
    "main",
    "plant",
    "resolver",
]
