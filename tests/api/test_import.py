"""Importing gnc_opt loads nothing heavy before it is used."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = (
    "scipy.stats",
    "scipy.optimize",
    "scipy.integrate",
    "scipy.sparse",
    "scipy.linalg",
    "matplotlib",
    "rich",
    "dask",
)


@pytest.mark.parametrize(
    "package", ["gnc_opt", "gnc_opt.control", "gnc_opt.simulation", "gnc_opt.spacecraft"]
)
def test_import_loads_nothing_heavy(package: str) -> None:
    program = f"import sys, {package}; print(*sorted(set({HEAVY!r}) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
