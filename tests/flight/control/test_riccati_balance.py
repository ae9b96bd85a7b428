"""Balancing of matrices that are nilpotent but for rounding."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.linalg import matrix_balance

from gnc_opt.control.riccati import require_stabilizable, steady

ALMOST = np.array([[0.0, 1.0], [1e-40, 0.0]])
LABELS = ("angle", "rate")


def test_scales_beyond_the_integers_are_no_warning_and_no_obstacle() -> None:
    with pytest.warns(RuntimeWarning, match="cast"):
        matrix_balance(ALMOST, permute=False, separate=True)  # what it is about
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        require_stabilizable(ALMOST, np.array([[0.0], [1.0]]), LABELS)
        none = np.zeros((2, 1))
        regulator = steady(ALMOST, np.array([[0.0], [1.0]]), np.eye(2), np.eye(1), none, LABELS)
    np.testing.assert_allclose(regulator.gain, [[1.0, np.sqrt(3.0)]], rtol=1e-12)
