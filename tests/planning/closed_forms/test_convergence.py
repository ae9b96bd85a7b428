"""Observed convergence in degree, measured by the benchmark's own functions."""

from __future__ import annotations

import numpy as np
import pytest
from testing.closed_forms import SCHEMES

from benchmarks.performance.convergence import Case, Row, brachistochrone, figure, main, measure, regulator


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("case", [regulator(), brachistochrone()], ids=lambda case: case.name)
def test_spectral_convergence(case: Case, scheme: str) -> None:
    """From 4 to 8 points every error falls by 400 at least; a fixed order p would give 2^p, so p > 8.

    What is then left is of the size that the entire functions of these problems allow.
    """
    rows = [measure(case, scheme, degree) for degree in (4, 6, 8)]
    for quantity in ("state", "control", "costate", "objective"):
        errors = np.array([getattr(row, quantity) for row in rows])
        assert errors[2] < max(errors[0] / 400, 1e-9), (quantity, errors)
    assert rows[2].state < 2e-7
    assert rows[2].control < 5e-6
    assert rows[2].costate < 3e-8


@pytest.mark.parametrize("scheme", SCHEMES)
def test_initial_costate_converges_twice_as_fast(scheme: str) -> None:
    """lam(t0) is the derivative of the discrete optimal cost: its error is about the square of the others."""
    row = measure(regulator(), scheme, 5)
    assert row.initial_costate < 20 * row.control**2
    assert row.objective < 20 * row.control**2


def test_outputs(tmp_path, capsys) -> None:
    """The table names schemes and quantities; JSON and figure are written, failed solves as null and dash."""
    assert (
        main(["--degrees", "2", "--json", str(tmp_path / "a.json"), "--figure", str(tmp_path / "a.png")]) == 0
    )
    text = capsys.readouterr().out
    assert "scalar regulator" in text
    assert "LGL" in text
    assert "null" in (tmp_path / "a.json").read_text()
    assert (tmp_path / "a.png").stat().st_size > 10_000
    failed = Row("case", "LG", 1, 0, *[float("nan")] * 5)
    assert figure([failed, Row("case", "LG", 2, 3, 1e-3, 1e-3, 1e-3, 1e-3, 0.0)], tmp_path / "b.pdf").exists()
