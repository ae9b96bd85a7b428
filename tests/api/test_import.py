"""Importing gnc_opt loads nothing heavy before it is used."""

from __future__ import annotations

import subprocess
import sys

import pytest

import gnc_opt

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
    "package",
    [
        "gnc_opt",
        "gnc_opt.control",
        "gnc_opt.simulation",
        "gnc_opt.analysis",
        "gnc_opt.spacecraft",
        "gnc_opt.report",  # which prints solutions, most of which nobody draws
    ],
)
def test_import_loads_nothing_heavy(package: str) -> None:
    program = f"import sys, {package}; print(*sorted(set({HEAVY!r}) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_reports_load_neither_figures_nor_the_closed_loop_before_they_are_drawn() -> None:
    loaded = "{'matplotlib', 'scipy.optimize', 'gnc_opt.simulation'} & set(sys.modules)"
    program = f"import sys, gnc_opt.report; print({loaded})"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["set()"]


def test_import_leaves_the_closed_loop_until_it_is_asked_for() -> None:
    program = (
        "import sys, gnc_opt as go; rooms = {'gnc_opt.control', 'gnc_opt.simulation', 'gnc_opt.analysis'};"
        "print(rooms & set(sys.modules)); go.linear_covariance; print(rooms <= set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["set()", "True"]


def test_every_public_name_is_there_and_no_other() -> None:
    assert set(gnc_opt.__all__) <= set(dir(gnc_opt))
    assert all(hasattr(gnc_opt, name) for name in gnc_opt.__all__)
    with pytest.raises(AttributeError, match="'gnc_opt' has no attribute 'design_lqg'"):
        gnc_opt.design_lqg  # type: ignore[attr-defined]  # noqa: B018
