"""Attitude control of a flexible spacecraft: quasi-sliding mode as published, and the same slew made optimal.

The publication turns a hub with four appendage modes by 143 degrees under a torque limit of 0.5 N m. Its numbers are
reproduced as far as they can be (`problems.flexible_spacecraft_published`); the slew is done in the least time and with
the least vibration, no modal energy left at the end, and tracked (`problems.flexible_spacecraft_optimal`). One model
serves all of it: `problems.flexible_spacecraft_system`. The page is docs/flexible_spacecraft.md.
"""

from __future__ import annotations

from collections.abc import Sequence

from problems.comparison import Row, run_comparison
from problems.flexible_spacecraft_law import law_rows
from problems.flexible_spacecraft_optimal import REFERENCE, build, build_gentle, optimal_rows
from problems.flexible_spacecraft_plant import plant_rows
from problems.flexible_spacecraft_published import configuration_rows
from problems.flexible_spacecraft_system import build_model, quasi_sliding_mode

__all__ = ["REFERENCE", "build", "build_gentle", "build_model", "comparison", "main", "quasi_sliding_mode"]


def comparison() -> list[Row]:
    """Return every row: plant, configurations, what the law does, optimal slews and their tracking."""
    return plant_rows() + configuration_rows() + law_rows() + optimal_rows()


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 if a number that is asserted misses its tolerance."""
    from problems.flexible_spacecraft_figures import write_figures

    return run_comparison("flexible_spacecraft", "Flexible spacecraft", comparison, write_figures, arguments)


if __name__ == "__main__":
    raise SystemExit(main())
