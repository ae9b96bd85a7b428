"""Can the verdict be fooled, does it raise false alarms, does it leave things untold? See `benchmarks.verdict.command`.

In the order of reading: `statements` (problems in any units, with any origin and scale of the cost), `changes` (what
makes the answer of one problem a wrong answer of another), `extremals` (stationary, but no minimum), `pairs`
(closed forms and what only looks like one; more in `closed_forms`, `limits`, `degenerate`), `families`, `forged`
(numbers changed in a file), `right` (what must pass), `cases`, `table` (what came of them), `command`.
"""

from benchmarks.verdict.command import main

__all__ = ["main"]
