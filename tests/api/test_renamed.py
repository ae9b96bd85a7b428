"""Former names raise an error that names the present one, which exists."""

from importlib import import_module

import pytest

from gnc_opt.renamed import RENAMED, RenamedError


@pytest.mark.parametrize("former", RENAMED)
def test_a_former_name_reports_the_present_one(former: str) -> None:
    module, _, name = former.rpartition(".")
    present = RENAMED[former]
    with pytest.raises(RenamedError, match=present):
        getattr(import_module(module), name)
    home, _, last = present.rpartition(".")
    assert getattr(import_module(home), last) is not None


def test_an_import_of_a_former_name_reports_the_present_one() -> None:
    with pytest.raises(
        ImportError, match=r"gnc_opt\.control\.design_ekf is now gnc_opt\.estimation\.design_ekf"
    ):
        from gnc_opt.control import design_ekf  # noqa: F401
