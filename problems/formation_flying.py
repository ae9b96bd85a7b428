"""Formation flying with oblateness: sliding mode against optimal sliding mode as published, and the optimum.

A follower joins a circle of 1 km radius around its leader. The publication compares two laws by four
numbers, which are reproduced (`problems.formation_flying_published`); the same formation is then reached
with the least Delta-V and in the least time, and both plans are flown by the publication's better law
(`problems.formation_flying_optimal`). One model serves all of it: `problems.formation_flying_system`. The
page is docs/formation_flying.md.
"""

from __future__ import annotations

from collections.abc import Sequence

from problems.comparison import Row, compare, require, run_comparison
from problems.formation_flying_laws import delta_v
from problems.formation_flying_optimal import REFERENCE, RESERVE, build, build_fast, miss_at, plan, track
from problems.formation_flying_published import (
    claim_rows,
    course_rows,
    run,
    sweep_rows,
    switching_rows,
    table_rows,
    truth_rows,
)
from problems.formation_flying_system import build_model

__all__ = ["REFERENCE", "build", "build_fast", "build_model", "comparison", "main"]


def comparison() -> list[Row]:
    """Return every row: publication, courses, switching, inertial truth, phases, and the optima."""
    published = table_rows() + course_rows() + switching_rows() + truth_rows() + sweep_rows() + claim_rows()
    return published + optimal_rows()


def optimal_rows() -> list[Row]:
    """The optima against the publication's manoeuvre, and how they are held against the oblateness."""
    spent, settled = delta_v(run("optimal SMC")), run("optimal SMC").settling_time("r", 1.0)
    rows = [
        compare(
            "least Delta-V in one period (m/s)",
            REFERENCE.value,
            plan("least Delta-V").solution.objective,
            absolute=REFERENCE.tolerance,
            reason="thrust of at most 3e-3 m/s^2 per axis",
        ),
        compare(
            "least time to the formation (s)",
            738.51683269,
            plan("least time").solution.objective,
            absolute=1e-4,
            reason="thrust of at most 3e-3 m/s^2",
        ),
    ]
    ratios = {
        "least Delta-V": (
            "Delta-V, optimum over optimal SMC",
            plan("least Delta-V").solution.objective / spent,
        ),
        "least time": (
            "time, optimum over optimal SMC to 1 m",
            plan("least time").solution.objective / settled,
        ),
    }
    for name, (what, ratio) in ratios.items():
        failed = ", ".join(c.name for c in plan(name).verdict.failed)
        rows.append(
            require(
                f"{name}: conditions that fail",
                "none",
                len(plan(name).verdict.failed),
                not failed,
                reason=failed,
            )
        )
        rows.append(require(what, "< 1", ratio, ratio < 1))
        planned = plan(name, RESERVE, False)
        flown = track(planned)
        miss = miss_at(flown, planned.final_time)
        reason = f"{100 * RESERVE:.0f} % of the thrust in reserve, oblateness unknown to the plan"
        rows.append(require(f"{name}, tracked: outcome", "ok", float(flown.outcome.ok), flown.outcome.ok))
        rows.append(
            require(f"{name}, tracked: |e| on arrival (m)", "< 0.06", miss, miss < 0.06, reason=reason)
        )
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 if a number that is asserted misses its tolerance."""
    from problems.formation_flying_figures import write_figures

    return run_comparison("formation_flying", "Formation flying", comparison, write_figures, arguments)


if __name__ == "__main__":
    raise SystemExit(main())
