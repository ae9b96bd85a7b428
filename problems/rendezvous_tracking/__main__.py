"""``python -m problems.rendezvous_tracking``: the planned rendezvous tracked, a campaign per controller."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from gnc_opt.simulation import Campaign
from problems._campaign_table import kept_in, parser, table, write
from problems._example import wide_console
from problems.rendezvous import CASES
from problems.rendezvous_tracking.control import CONTROLLERS, RESERVE, SHOWN, Tracking, plan
from problems.rendezvous_tracking.guidance import Filtered, Guided, Measured
from problems.rendezvous_tracking.replanning import PLANNED, Replanned

COSTLY = ("MPC", "re-planned, filtered")
"""A run of the MPC solves some 480 quadratic programmes, one that is re-planned four problems."""
COSTLY_RUNS = 100
DEMANDED = 0.99
"""Pass rate of the controllers with feedback."""
ERRORS = {measure: (f"{label} ({unit})", factor) for measure, (label, factor, unit) in SHOWN.items()}
COSTS = {
    "effort(F_B)": ("effort F (N s)", 1.0),
    "effort(T_B)": ("effort T (N m s)", 1.0),
    "saturation(F_B)": ("F saturated (s)", 1.0),
    "saturation(T_B)": ("T saturated (s)", 1.0),
}
_LEVELS = (0.5, 0.99)
_WIDTH = 190


def methods(case: int, tracking: Tracking) -> dict[str, Callable[[], Tracking]]:
    """Return what is simulated: controllers of one plan, and guidance with more of the authority."""
    return {
        **dict.fromkeys(CONTROLLERS, lambda: tracking),
        "TVLQR, EKF": lambda: Filtered(tracking.solution),
        "guided": lambda: Guided(plan(case, 1.0)),
        "guided, filtered": lambda: Measured(plan(case, 1.0)),
        "re-planned, filtered": lambda: Replanned(plan(case, PLANNED, refined=False), case),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Plan, simulate, evaluate and draw; see ``python -m problems.rendezvous_tracking --help``.

    Returns
    -------
    int
        0; 1 if a controller with feedback misses its pass rate.
    """
    description = (
        "The time-optimal rendezvous tracked: open loop, TVLQR, integral sliding mode and MPC; and guided."
    )
    command = parser("python -m problems.rendezvous_tracking", description)
    command.add_argument("--case", type=int, choices=list(CASES), default=1, help="initial position")
    command.add_argument(
        "--costly-runs",
        type=int,
        default=COSTLY_RUNS,
        help=f"most runs of '{COSTLY[0]}' and '{COSTLY[1]}', default {COSTLY_RUNS}",
    )
    command.add_argument("--report", type=Path, metavar="DIR", help="write the figures to a folder")
    options = command.parse_args(arguments)
    console = wide_console(_WIDTH)
    tracking = Tracking(plan(options.case))
    console.print(
        f"case {options.case}: planned with {RESERVE:.0%} of the authority, t_f = "
        f"{tracking.reference.final_time:.6f} s, evaluated at {tracking.end:.4f} s; seed {options.seed}"
    )
    campaigns: dict[str, Campaign] = {}
    for name, design in methods(options.case, tracking).items():
        runs = min(options.runs, options.costly_runs) if name in COSTLY else options.runs
        if runs < 1:
            continue
        begin, method = time.perf_counter(), design()
        campaigns[name] = method.simulate_campaign(
            name,
            runs,
            options.seed,
            progress=console.is_terminal,
            checkpoint=kept_in(options.checkpoint, name),
        )
        arrivals = method.arrivals(campaigns[name])
        console.print(
            f"{name}: {runs} runs in {time.perf_counter() - begin:.1f} s, design included; arrival after "
            f"{np.mean(arrivals):.3f} s on average, {np.max(arrivals):.3f} s at the latest"
        )
    console.print()
    console.print(table("Errors at the end", campaigns, ERRORS, levels=_LEVELS))
    console.print(table("Cost", campaigns, COSTS, levels=_LEVELS))
    if options.json is not None:
        write(options.json, campaigns)
    if options.report is not None:
        draw(campaigns, options.report)
    rates = {name: campaign.pass_rate().rate for name, campaign in campaigns.items()}
    missed = [name for name, rate in rates.items() if name != "open loop" and rate < DEMANDED]
    for name in missed:
        console.print(f"{name} passes {rates[name]:.1%} of its runs; {DEMANDED:.0%} are demanded.")
    return 1 if missed else 0


def draw(campaigns: Mapping[str, Campaign], folder: Path) -> None:
    """Write a figure of the dispersed positions per controller."""
    from gnc_opt.plot.campaign_figures import plot_dispersion
    from gnc_opt.plot.figure_style import save_figure

    for name, campaign in campaigns.items():
        stem = name.replace(", ", "_").replace(" ", "_").lower()
        save_figure(plot_dispersion(campaign, "r_L"), folder / f"dispersion_{stem}.png")


if __name__ == "__main__":
    raise SystemExit(main())
