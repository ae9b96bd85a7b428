"""``python -m problems.rocket_landing``: landings as planned, with re-planning in flight, and by ZEM/ZEV."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gnc_opt.simulation import Campaign
from problems._campaign_table import kept_in, parser, table, write
from problems._example import wide_console
from problems.rocket_landing.control import CONTROLLERS, LIMITS, Landing
from problems.rocket_landing.model import PLANNED, START

DEMANDED = 0.99
"""Share of the runs that the plan made again has to land within all limits."""

_UNITS = {"miss": "m", "speed across": "m/s", "speed downward": "m/s", "propellant": "kg"}
_COUNTS = {
    "replans": lambda flown: np.nansum(flown.measure("replans")),
    "failed": lambda flown: np.nansum(flown.measure("failed replans")),
    "crashes": lambda flown: flown.event_totals["crash"],
}
_WIDTH = 110


def main(arguments: Sequence[str] | None = None) -> int:
    """Plan, simulate and evaluate; see ``python -m problems.rocket_landing --help``.

    Returns
    -------
    int
        0; 1 if the plan made again in flight lands fewer than `DEMANDED` within all limits.
    """
    options = parser(
        "python -m problems.rocket_landing",
        "A rocket lands in wind: as planned, with the plan made again in flight, and by ZEM/ZEV.",
    ).parse_args(arguments)
    console = wide_console(_WIDTH)
    landing = Landing()
    leg = landing.plan.phase()
    burnt = START["mass"] - float(leg.x(leg.final_time)[6])
    console.print(
        f"planned with {PLANNED[0]:.0%} to {PLANNED[1]:.0%} of the engines: {leg.final_time:.3f} s, {burnt:.2f} kg of "
        f"propellant; seed {options.seed}"
    )
    campaigns: dict[str, Campaign] = {}
    for name in CONTROLLERS:
        place = kept_in(options.checkpoint, name)
        campaigns[name] = landing.simulate_campaign(
            name, options.runs, options.seed, progress=console.is_terminal, checkpoint=place
        )
    measures = {name: (f"{name} ({unit})", 1.0) for name, unit in _UNITS.items()}
    console.print(table("Landings", campaigns, measures, _COUNTS))
    results = ", ".join(f"{name} {limit:g} {_UNITS[name]}" for name, limit in LIMITS.items())
    console.print(f"limits: {results}")
    if options.json is not None:
        write(options.json, campaigns)
    rate = campaigns["re-planned"].pass_rate().rate
    if rate < DEMANDED:
        console.print(f"the plan made again lands {rate:.1%} within all limits; {DEMANDED:.0%} are demanded.")
    return int(rate < DEMANDED)


if __name__ == "__main__":
    raise SystemExit(main())
