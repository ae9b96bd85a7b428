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


def printed(program: str) -> list[str]:
    """What another process prints that runs this program."""
    return subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout.split()


@pytest.mark.parametrize(
    "package",
    [
        "gnc_opt.solve",
        "gnc_opt.resolve",
        "gnc_opt.study",
        "gnc_opt.verify",
        "gnc_opt.control",
        "gnc_opt.simulation",
        "gnc_opt.analysis",
        "gnc_opt.spacecraft",
        "gnc_opt.report",  # which prints solutions, most of which nobody draws
    ],
)
def test_import_loads_nothing_heavy(package: str) -> None:
    assert printed(f"import sys, {package}; print(*sorted(set({HEAVY!r}) & set(sys.modules)))") == []


def test_import_alone_loads_nothing_and_a_name_what_it_needs() -> None:
    others = "print(*sorted({name.partition('.')[0] for name in sys.modules} & {'numpy', 'casadi'}))"
    assert printed(f"import sys, gnc_opt; {others}") == []
    assert printed(f"import sys, gnc_opt; gnc_opt.Model; {others}") == ["casadi", "numpy"]
    assert printed("import sys, gnc_opt; gnc_opt.Problem; print('gnc_opt.refine.refine' in sys.modules)") == [
        "False"
    ]


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


FUNCTIONS_WITH_A_MODULE = ("bound_below", "refine", "solve", "verify")


@pytest.mark.parametrize("first", [*FUNCTIONS_WITH_A_MODULE, "study", "report"])
def test_names_are_functions_whichever_module_was_loaded_first(first: str) -> None:
    """`import` binds a submodule under its name, after which a package is not asked for that name any more."""
    names = f"for name in {FUNCTIONS_WITH_A_MODULE!r}: print(type(getattr(gnc_opt, name)).__name__)"
    assert printed(f"import gnc_opt.{first}\n{names}") == ["function"] * 4
    again = f"import gnc_opt; gnc_opt.{first}; import gnc_opt.{first}, gnc_opt.resolve\n{names}"
    assert printed(again) == ["function"] * 4


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
    with pytest.raises(AttributeError, match="'gnc_opt' has no attribute 'design_lqg'"):
        gnc_opt.design_lqg  # type: ignore[attr-defined]  # noqa: B018
