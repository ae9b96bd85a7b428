"""``python -m problems.attitude_control``: campaigns of three controllers from sensors to motors, side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from rich.console import Console

from gnc_opt.analysis import consistency
from gnc_opt.simulation import Campaign
from problems._campaign_table import kept_in, parser, table, write
from problems._example import wide_console
from problems.attitude_control.control import LAWS, LIMITS, estimator, simulate_campaign
from problems.attitude_control.model import slew

DEMANDED = 0.99
"""Share of the runs in which the regulator along the slew has to meet all limits."""
WITHOUT = "least energy, no bias estimated"

MEASURES = {
    "max(pointing)": ("off target (deg)", float(np.degrees(1.0))),
    "max(rate)": ("fastest (deg/s)", float(np.degrees(1.0))),
    "max(torque)": ("torque (N m)", 1.0),
    "max(speed)": ("speed (rpm)", 1.0),
    "energy(T)": ("sum T^2 (N^2 m^2 s)", 1.0),
}
"""Of a campaign: what is printed, and the factor to its unit."""

_WIDTH = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Plan, simulate and evaluate; see ``python -m problems.attitude_control --help``.

    Returns
    -------
    int
        0; 1 if the regulator along the slew meets all limits in fewer than `DEMANDED` of its runs, or if any law ever
        asks too much of a wheel.
    """
    options = parser(
        "python -m problems.attitude_control",
        "Slews with four wheels by star tracker, gyro and tachometers: a plan and two published laws.",
    ).parse_args(arguments)
    console = wide_console(_WIDTH)
    console.print(f"slew of least energy: {slew().objective:.6f} N^2 m^2 s; seed {options.seed}")
    campaigns = {
        name: simulate_campaign(
            LAWS[0] if name == WITHOUT else name,
            options.runs,
            options.seed,
            bias=name != WITHOUT,
            progress=console.is_terminal,
            checkpoint=kept_in(options.checkpoint, name),
        )
        for name in (*LAWS, WITHOUT)
    }
    console.print(table("Slews from sensors to motors", campaigns, MEASURES))
    results = ", ".join(
        f"{MEASURES[name][0]} {MEASURES[name][1] * limit:g}" for name, limit in LIMITS.items()
    )
    console.print(f"limits: {results}")
    console.print(str(consistency(campaigns[LAWS[0]], estimator())))
    if options.json is not None:
        write(options.json, campaigns)
    return int(bool(_failures(campaigns, console)))


def _failures(campaigns: Mapping[str, Campaign], console: Console) -> list[str]:
    """Return what is not as demanded, printed, too."""
    rate = campaigns[LAWS[0]].pass_rate().rate
    found = []
    if rate < DEMANDED:
        found.append(
            f"the regulator meets all limits in {rate:.1%} of its runs; {DEMANDED:.0%} are demanded."
        )
    for name, flown in campaigns.items():
        for measure in ("max(torque)", "max(speed)"):
            if not np.all(flown.measure(measure) <= LIMITS[measure]):
                found.append(
                    f"{name}: {measure} is {flown.maximum(measure):g}, {LIMITS[measure]:g} is the limit."
                )
    for line in found:
        console.print(line)
    return found


if __name__ == "__main__":
    raise SystemExit(main())
