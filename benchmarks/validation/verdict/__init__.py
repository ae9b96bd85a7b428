"""Planted wrong answers and right ones, and their verdicts: ``python -m benchmarks.validation.verdict``.

In the order of reading: `statements` (problems in any units, with any origin and scale of the cost), `wrong_answers`
(the answer of one problem given for another), `non_minimal_extremals`, `pairs` (closed forms and what only looks like
one), `thresholds`, `correct_answers`, `cases` (all of them, and what came of each).
"""
