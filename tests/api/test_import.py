"""Importing gnc_opt loads nothing heavy before it is used."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import version

import pytest

import gnc_opt

HEAVY = (
    "scipy.stats", "scipy.optimize", "scipy.integrate", "scipy.sparse", "scipy.linalg", "matplotlib", "rich",
    "dask",
)  # fmt: skip


def printed(program: str) -> list[str]:
    """What another process prints that runs this program."""
    return subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout.split()


PACKAGES = (
    "gnc_opt.planning.optimal_control_solver",
    "gnc_opt.planning.study",
    "gnc_opt.planning.verification",
    "gnc_opt.control",
    "gnc_opt.simulation",
    "gnc_opt.analysis",
    "gnc_opt.spacecraft",
    "gnc_opt.report",  # which prints solutions, most of which nobody draws
)


def test_import_loads_nothing_heavy() -> None:
    """One after the other in one process: what any of them loads stays, and is told with its name."""
    program = f"""
import importlib, sys
for package in {PACKAGES!r}:
    importlib.import_module(package)
    print(package, *sorted(set({HEAVY!r}) & set(sys.modules)))
"""
    assert printed(program) == [*PACKAGES]


def test_import_alone_loads_nothing_and_a_name_what_it_needs() -> None:
    others = "print(*sorted({name.partition('.')[0] for name in sys.modules} & {'numpy', 'casadi'}))"
    assert printed(f"import sys, gnc_opt; {others}") == []
    assert printed(f"import sys, gnc_opt; gnc_opt.Model; {others}") == ["casadi", "numpy"]
    assert printed(
        "import sys, gnc_opt; gnc_opt.Problem; print('gnc_opt.planning.refinement.staged_refinement' in sys.modules)"
    ) == ["False"]


def test_reports_load_neither_figures_nor_the_closed_loop_before_they_are_drawn() -> None:
    loaded = "{'matplotlib', 'scipy.optimize', 'gnc_opt.simulation'} & set(sys.modules)"
    program = f"import sys, gnc_opt.report; print({loaded})"
    assert printed(program) == ["set()"]


def test_import_leaves_the_closed_loop_until_it_is_asked_for() -> None:
    program = (
        "import sys, gnc_opt as go; rooms = {'gnc_opt.control', 'gnc_opt.simulation', 'gnc_opt.analysis'};"
        "print(rooms & set(sys.modules)); go.linear_covariance; print(rooms <= set(sys.modules))"
    )
    assert printed(program) == ["set()", "True"]


def test_a_function_of_a_script_that_uses_the_package_can_be_sent_to_a_cluster() -> None:
    """What is defined in a script is pickled whole, with the modules that it names."""
    pytest.importorskip("cloudpickle")
    program = (
        "import gnc_opt as go, cloudpickle\ndef loaded(): return go.solve.__name__\n"
        "print(cloudpickle.loads(cloudpickle.dumps(loaded))())"
    )
    assert printed(program) == ["solve"]


def test_every_public_name_is_there_and_no_other() -> None:
    assert set(gnc_opt._MODULES) == set(gnc_opt.__all__) <= set(dir(gnc_opt))
    assert all(hasattr(gnc_opt, name) for name in gnc_opt.__all__)
    assert gnc_opt.__version__ == version("gnc_opt")
    with pytest.raises(AttributeError, match="'gnc_opt' has no attribute 'design_lqg'"):
        gnc_opt.design_lqg  # type: ignore[attr-defined]  # noqa: B018
