"""A mutation tester: would the tests notice if the code were wrong?

``python -m benchmarks.mutants record --map DIR`` runs the tests once and notes which test runs which line.
``python -m benchmarks.mutants run --map DIR --session FILE --package gnc_opt/control --sample 30 --seed 1`` then
changes the code in one place at a time, in a copy of the tree, and runs the tests that come by that place. What no
test notices is listed; `equivalent.json` lists the changes that no test could notice, with the reasons. A session is
taken up where it ended; ``--again`` tries its survivors once more, after new tests have been recorded.

A map outlives edits: it keeps the files that it was recorded for, and counts where a line has stayed. Tests that are
new since are recorded path by path. What a test kills is killed, whatever the map; what survives is certain only with a
fresh one.

Why not mutmut or cosmic-ray: mutmut leaves out decorated functions (properties, here every second function), and
cosmic-ray runs the same tests for every mutant; neither draws a seeded sample by package.

Modules: `mutations` (what is changed), `cover` (which test runs which line), `trial` (one mutant), `command`.
"""

from benchmarks.mutants.command import main

__all__ = ["main"]
