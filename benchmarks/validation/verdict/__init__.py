"""Planted wrong answers and right ones, and their verdicts: ``python -m benchmarks.validation.verdict``.

In the order of reading: `statements` (problems in any units, with any origin and scale of the cost), `wrong_answers`
(the answer of one problem given for another), `answers` (closed forms and what only looks like one; by class of problem
in `unconstrained`, `bounded_controls`, `end_and_integral_constraints`, `multi_phase`, `state_constraints`,
`parameters_and_control_sets`, `degenerate`), `non_minimal_extremals`, `thresholds`, `correct_answers`, `cases` (all of
them, and what came of each).
"""
