"""The active-set solver in C: its bound of operations, and the steps of its table."""

from __future__ import annotations

import numpy as np
from testing.internals import Rows

from gnc_opt.control import active_set_qp as programme_code
from gnc_opt.control.active_set_qp import ProgrammeCode, _Numbered


def test_operations_of_a_programme_by_hand():
    """One control over two errors and one step: a sweep, there and back, is 2 * 3^2 products and 6 for 1 + 3 rows."""
    limits = Rows(np.full(1, -1.0), np.ones(1), None, (), (), np.zeros(0), np.zeros(0), np.zeros(0))
    code = ProgrammeCode(limits, np.zeros(0), (np.zeros((1, 2, 2)),) * 4, True, 1, 2)
    assert code.unknowns == code.limits == 1
    sweep, tries = 2 * 3**2 + 6 * 4, programme_code._ITERATIONS_PER_UNKNOWN * 2
    row = 2 * sweep + 4
    assert code.operations == tries * (2 * sweep + 6 + 2 * 9 + row + 12) + 2 * 3
    assert code.stack == (3 + 5 * 2 + 1) + 4 + 6 * 2 + 4 + 3


def test_steps_have_their_number_in_the_table():
    """From 0 to the step in which the reference ends; times are what a clock tells, with its rounding."""
    row = _Numbered(lambda times, dt: np.zeros((1, times.size)), (1.0, 2.0))
    times = np.array([0.0, 1.0, 1.25 - 1e-9, 1.25, 1.49, 1.75, 2.0, 9.0])
    assert row(times, 0.25)[1].tolist() == [0, 0, 1, 1, 1, 3, 4, 4]
    assert row(np.array([1.9, 2.0, 3.0]), 0.3)[1].tolist() == [3, 3, 4]
    for span in (1.0 - 1e-12, 1.0 + 1e-12):
        assert _Numbered(row.reference, (0.0, span))(np.array([7.0]), 0.1)[1].tolist() == [10]
