"""Every public name is documented, typed, and cheap to import.

The rule: every public name of gnc_opt, and every public method and property of its classes, has a docstring.
Functions and constructors describe each parameter by name in numpydoc sections. Methods may do with prose:
their own docstring, or that of their class for what all methods share, names every parameter but two at most
(which name and type explain), or points to a method that does ("as in `state`").
"""

import enum
import inspect
import re
import subprocess
import sys
from importlib import resources

import pytest

import gnc_opt

PUBLIC = sorted(gnc_opt.__all__)
CLASSES = [name for name in PUBLIC if inspect.isclass(getattr(gnc_opt, name))]
FUNCTIONS = [name for name in PUBLIC if inspect.isfunction(getattr(gnc_opt, name))]
FREE = 2
"""Parameters that a method's docstring may leave unnamed."""


def own_members(cls: type) -> dict[str, object]:
    """Public methods and properties that gnc_opt itself defines on a class, inherited ones included."""
    members: dict[str, object] = {}
    for base in reversed(cls.__mro__):
        if base.__module__.startswith("gnc_opt"):
            members |= {n: v for n, v in vars(base).items() if not n.startswith("_")}
    return {n: v for n, v in members.items() if is_documentable(v)}


def is_documentable(value: object) -> bool:
    kinds = (property, classmethod, staticmethod)
    return inspect.isfunction(value) or isinstance(value, kinds) or type(value).__name__ == "cached_property"


METHODS = [
    pytest.param(getattr(gnc_opt, c), name, id=f"{c}.{name}")
    for c in CLASSES
    for name in own_members(getattr(gnc_opt, c))
]


def parameters(function: object) -> list[str]:
    named = inspect.signature(function).parameters  # type: ignore[arg-type]
    return [name for name in named if name not in ("self", "cls")]


def section(doc: str, title: str) -> str:
    """The text of a numpydoc section, up to the next one."""
    lines = inspect.cleandoc(doc).splitlines()
    for i, line in enumerate(lines[:-1]):
        if line.strip() == title and set(lines[i + 1].strip()) == {"-"}:
            rest = lines[i + 2 :]
            ends = [j for j, text in enumerate(rest) if text and set(text.strip()) == {"-"}]
            return "\n".join(rest[: ends[0] - 1] if ends else rest)
    return ""


def described(doc: str, title: str) -> set[str]:
    """Names that a section describes: those at the start of unindented lines, "a, b : float"."""
    heads = [line.split(":")[0] for line in section(doc, title).splitlines() if line[:1].strip()]
    return {name.strip().lstrip("*") for head in heads for name in head.split(",")}


def test_all_names_exist_and_are_sorted() -> None:
    assert len(set(gnc_opt.__all__)) == len(gnc_opt.__all__)
    for name in gnc_opt.__all__:
        assert hasattr(gnc_opt, name), name
    assert len(PUBLIC) >= 16


@pytest.mark.parametrize("name", PUBLIC)
def test_public_name_has_a_docstring_of_its_own(name: str) -> None:
    doc = vars(getattr(gnc_opt, name)).get("__doc__") or getattr(gnc_opt, name).__doc__
    assert doc and len(doc.split()) >= 3, f"{name} has no docstring"
    assert not doc.startswith(f"{name}("), f"{name} has only the docstring that dataclass made"


@pytest.mark.parametrize("name", FUNCTIONS)
def test_public_function_describes_parameters_and_result(name: str) -> None:
    function = getattr(gnc_opt, name)
    missing = set(parameters(function)) - described(function.__doc__, "Parameters")
    assert not missing, f"{name} does not describe {missing}"
    assert section(function.__doc__, "Returns"), f"{name} does not say what it returns"
    assert section(function.__doc__, "Raises"), f"{name} does not say what it raises"


@pytest.mark.parametrize("name", CLASSES)
def test_public_class_describes_its_fields(name: str) -> None:
    cls = getattr(gnc_opt, name)
    if issubclass(cls, (enum.Enum, BaseException)) or name == "Phase":  # made by Problem.phase only
        return
    told = described(cls.__doc__, "Parameters") | described(cls.__doc__, "Attributes")
    missing = set(parameters(cls)) - told
    assert not missing, f"{name} does not describe {missing}"


@pytest.mark.parametrize(("cls", "name"), METHODS)
def test_public_method_is_documented(cls: type, name: str) -> None:
    member = own_members(cls)[name]
    function = getattr(
        member, "__func__", getattr(member, "fget", None) or getattr(member, "func", None) or member
    )
    doc = function.__doc__ or ""
    assert doc, f"{cls.__name__}.{name} has no docstring"
    if isinstance(member, property) or type(member).__name__ == "cached_property":
        return
    told = set(re.findall(r"\w+", f"{doc} {cls.__doc__}"))
    silent = [p for p in parameters(function) if p not in told]
    assert len(silent) <= FREE or re.search(r"(as in|see) ``?[\w.]+``?", doc), (
        f"{cls.__name__}.{name} does not describe {silent}"
    )


def test_package_is_marked_as_typed() -> None:
    assert resources.files("gnc_opt").joinpath("py.typed").is_file()


def test_import_leaves_plotting_and_terminal_libraries_alone() -> None:
    heavy = "sorted({'matplotlib', 'rich', 'pytest'} & set(__import__('sys').modules))"
    done = subprocess.run(
        [sys.executable, "-c", f"import gnc_opt; print({heavy})"], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"
