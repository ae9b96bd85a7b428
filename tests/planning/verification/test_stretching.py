"""Dense rows of a banded matrix: its stretched form has the same solutions, and factors no larger than its band."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from gnc_opt.planning.optimality.kkt import DENSE, factorised

N = 900


def saddle(dense: int, order: np.ndarray) -> scipy.sparse.csc_array:
    """An indefinite chain with dense rows, two of which meet, in some order of its rows."""
    random = np.random.default_rng(3)
    diagonals = [random.standard_normal(N - k) for k in range(4)]
    band = scipy.sparse.diags_array(diagonals, offsets=[0, 1, 2, 3])
    columns = scipy.sparse.csc_array(random.standard_normal((N, dense)))
    corner = np.diag(np.arange(dense, dtype=float)) + (np.ones((dense, dense)) - np.eye(dense))
    whole = scipy.sparse.block_array([[band + band.T, columns], [columns.T, corner]], format="csc")
    return scipy.sparse.csc_array(whole[order][:, order])


@pytest.mark.parametrize("dense", [0, 1, 3])
def test_solutions_are_those_of_the_matrix_itself(dense: int) -> None:
    order = np.random.default_rng(4).permutation(N + dense)
    matrix, right = saddle(dense, order), np.random.default_rng(5).standard_normal(N + dense)
    np.testing.assert_allclose(factorised(matrix)(right), np.linalg.solve(matrix.toarray(), right), rtol=1e-7)


def test_no_row_of_the_stretched_matrix_is_dense(monkeypatch: pytest.MonkeyPatch) -> None:
    """And it is symmetric: what couples all times at once has become copies of one unknown."""
    seen: list[scipy.sparse.csc_array] = []
    splu = scipy.sparse.linalg.splu

    def noted(matrix: scipy.sparse.csc_array) -> object:
        seen.append(matrix)
        return splu(matrix)

    monkeypatch.setattr(scipy.sparse.linalg, "splu", noted)
    matrix = saddle(2, np.arange(N + 2))
    assert np.max(np.diff(matrix.indptr)) > N
    factorised(matrix)
    (stretched,) = seen
    assert np.max(np.diff(stretched.indptr)) < DENSE
    assert abs(stretched - stretched.T).max() == 0.0
