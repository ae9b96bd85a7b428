"""Former names raise an error that names the present one, which exists."""

import operator
import re
from importlib import import_module
from pathlib import Path

import pytest

import gnc_opt
from gnc_opt.renamed_public_names import (
    GUESSED_MEMBERS,
    REMOVED,
    RENAMED,
    RENAMED_MEMBERS,
    RENAMED_PARAMETERS,
    RENAMED_STATUS_WORDS,
    RenamedError,
    StatusWord,
)


@pytest.mark.parametrize("former", RENAMED)
def test_a_former_name_reports_the_present_one(former: str) -> None:
    module, _, name = former.rpartition(".")
    present = RENAMED[former]
    with pytest.raises(RenamedError, match=present):
        getattr(import_module(module), name)
    home, _, last = present.rpartition(".")
    assert getattr(import_module(home), last) is not None


@pytest.mark.parametrize("former", REMOVED)
def test_a_removed_name_reports_what_to_use(former: str) -> None:
    module, _, name = former.rpartition(".")
    with pytest.raises(RenamedError, match=re.escape(f"{former} is removed: use {REMOVED[former]}.")):
        getattr(import_module(module), name)


def test_an_import_of_a_former_name_reports_the_present_one() -> None:
    with pytest.raises(
        ImportError, match=r"gnc_opt\.control\.design_ekf is now gnc_opt\.estimation\.design_ekf"
    ):
        from gnc_opt.control import design_ekf  # noqa: F401


@pytest.mark.parametrize(
    ("function", "former"), [("analysis.sobol_indices", "experiment"), ("monte_carlo", "judge")]
)
def test_a_former_parameter_reports_the_present_one(function: str, former: str) -> None:
    with pytest.raises(TypeError, match=f"'{former}': it is now '{RENAMED_PARAMETERS[former]}'"):
        operator.attrgetter(function)(gnc_opt)(**{former: None})


@pytest.mark.parametrize("former", RENAMED_MEMBERS)
def test_a_former_member_reports_the_present_one(former: str) -> None:
    model = gnc_opt.Model("m")
    model.state("x")
    model.ode({"x": 0.0})
    problem = gnc_opt.Problem("p")
    owners = {"Model": model, "Problem": problem, "Phase": problem.phase("leg", model)}
    kind, name = former.split(".")
    assert hasattr(owners[kind], RENAMED_MEMBERS[former])
    with pytest.raises(AttributeError, match=f"has no '{name}': it is now '{RENAMED_MEMBERS[former]}'"):
        getattr(owners[kind], name)


@pytest.mark.parametrize("guessed", GUESSED_MEMBERS)
def test_a_guessed_member_reports_the_right_one(guessed: str) -> None:
    kind, name = guessed.split(".")
    thing = object.__new__(getattr(gnc_opt, kind))
    with pytest.raises(AttributeError, match=re.escape(f"has no '{name}': use {GUESSED_MEMBERS[guessed]}.")):
        getattr(thing, name)
    present = GUESSED_MEMBERS[guessed].partition("(")[0]
    members = set(dir(thing)) | set(getattr(thing, "__annotations__", ()))
    assert present.partition(".")[0] in members or operator.attrgetter(present.partition(".")[2])(gnc_opt)


@pytest.mark.parametrize(
    "kind", [*StatusWord.__subclasses__(), gnc_opt.Status], ids=lambda kind: kind.__name__
)
def test_the_word_of_a_status_is_the_name_of_its_member(kind: type) -> None:
    assert [status.value for status in kind] == [status.name.lower() for status in kind]


def test_a_former_status_word_is_read_as_the_present_one() -> None:
    """Files of earlier releases contain it."""
    for former, present in RENAMED_STATUS_WORDS.items():
        kinds = [kind for kind in StatusWord.__subclasses__() if present in [status.value for status in kind]]
        assert kinds and all(kind(former).value == present for kind in kinds)
    with pytest.raises(ValueError, match="no_such_word"):
        gnc_opt.RunStatus("no_such_word")


def test_sources_use_no_former_name() -> None:
    """Messages and docstrings included. Names that are ordinary words as well (Ball, Share) are left out."""
    present = {name.rpartition(".")[2] for name in RENAMED.values()}
    former = {name.rpartition(".")[2] for name in RENAMED} - present
    former = {name for name in former if "_" in name or any(letter.isupper() for letter in name[1:])}
    former |= {"Experiment", "Explanation", "Occurrence"}
    assert len(former) > 12
    pattern = re.compile(rf"\b({'|'.join(sorted(former))})\b")
    package = Path(gnc_opt.__file__).parent
    found = [
        f"{path.relative_to(package)}: {name}"
        for path in package.rglob("*.py")
        if path.name != "renamed_public_names.py"
        for name in pattern.findall(path.read_text())
    ]
    assert not found
