"""What inline code in a page can stand for: names of the library, its calls, files, words of the source.

Inline code is read as Python where it is Python. A chain of names and calls is followed from the public names through
attributes and the annotated results of methods; what it is called with has to fit the signature. A single word need
only be a name or a value that some source file knows: names of states, values of options.
"""

from __future__ import annotations

import ast
import builtins
import contextlib
import enum
import importlib
import inspect
import re
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from types import ModuleType
from typing import Any

import gnc_opt as go
from testing.pages import ROOT
from testing.source_files import source_files, string_constants, walk_statements

INSTANCES: dict[str, type] = {
    "campaign": go.Campaign,
    "controller": go.Controller,
    "leg": go.Phase,
    "loop": go.ClosedLoop,
    "model": go.Model,
    "problem": go.Problem,
    "run": go.Run,
    "solution": go.Solution,
    "vehicle": go.Model,
    "verdict": go.Verdict,
}
"""What the pages call their objects."""


@dataclass(frozen=True)
class Thing:
    """Something that a name stands for: an object of Python, or an instance of a class."""

    value: Any
    instance: bool = False


@cache
def packages() -> tuple[ModuleType, ...]:
    """gnc_opt and its packages that declare public names."""
    folders = sorted(p.parent.name for p in (ROOT / "gnc_opt").glob("*/__init__.py"))
    found = [go, *(importlib.import_module(f"gnc_opt.{name}") for name in folders)]
    return tuple(module for module in found if hasattr(module, "__all__"))


@cache
def public() -> dict[str, Any]:
    """Every name that a package declares as public."""
    return {name: getattr(module, name) for module in packages() for name in module.__all__}


@cache
def source_names() -> frozenset[str]:
    """Names and values of options in the sources of gnc_opt and of the problems, and the extras of the package."""
    folders = ("gnc_opt", "problems", "benchmarks")
    found = set(
        re.findall(r"^(\w+) = \[", (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.MULTILINE)
    )
    for path in source_files(*folders):
        found |= {path.stem, path.parent.name}
        found.update(name for node in walk_statements(path) for name in _named(node))
        found.update(text for text in string_constants(path) if len(text) < 40)
    return frozenset(found)


def _named(node: ast.AST) -> Iterator[str]:
    if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
        yield node.name
        if isinstance(node, ast.FunctionDef):
            yield from (a.arg for a in ast.walk(node.args) if isinstance(a, ast.arg))
    elif isinstance(node, (ast.Assign, ast.AnnAssign)):
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        yield from (t.id for t in targets if isinstance(t, ast.Name))


@dataclass(frozen=True)
class Span:
    """One piece of inline code, and what is wrong with it."""

    text: str
    page_names: frozenset[str] = frozenset()

    @cached_property
    def mistake(self) -> str:
        """What the code and the sources disagree in; empty if nothing, or if it is no Python."""
        if self.is_path:
            return "" if self._exists or "NAME" in self.text else "no such file or folder"
        try:
            statement = ast.parse(self.text).body[0]
        except SyntaxError:
            return ""
        try:
            if isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Name):
                _check_option(statement.targets[0].id, statement.value)
            elif isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Name):
                self._check_word(statement.value.id)
            elif isinstance(statement, ast.Expr) and isinstance(statement.value, (ast.Attribute, ast.Call)):
                resolve(statement.value)
        except NameError as error:
            return str(error)
        return ""

    @property
    def is_path(self) -> bool:
        return bool(re.fullmatch(r"[\w./]*(\.(py|md|toml|json|yml|c|h)|/|\.ci/run)", self.text))

    @property
    def _exists(self) -> bool:
        if (ROOT / self.text).exists() or (ROOT / "gnc_opt" / self.text).exists():
            return True
        name = self.text.rpartition("/")[2]
        return "/" not in self.text and any(ROOT.glob(f"[gpbt]*/**/*{name}"))

    def _check_word(self, word: str) -> None:
        known = (
            word in public() or word in source_names() or word in self.page_names or hasattr(builtins, word)
        )
        if not known:
            raise NameError(f"nothing is called '{word}'")


def resolve(node: ast.expr) -> list[Thing]:
    """Return what an expression may stand for; raise NameError if it stands for nothing."""
    if isinstance(node, ast.Name):
        return _resolve_name(node.id)
    if isinstance(node, ast.Attribute):
        owners = resolve(node.value)
        found = [thing for owner in owners for thing in _attribute(owner, node.attr)]
        if not found:
            raise NameError(f"'{ast.unparse(node.value)}' has no '{node.attr}'")
        return found
    if isinstance(node, ast.Call):
        return _resolve_call(node)
    raise NameError(f"'{ast.unparse(node)}' cannot be followed")


def _resolve_name(name: str) -> list[Thing]:
    if name in ("go", "gnc_opt"):
        return [Thing(go)]
    if name in ("problems", "benchmarks"):
        return [Thing(importlib.import_module(name))]
    if name in INSTANCES:
        return [Thing(INSTANCES[name], instance=True)]
    if name in public():
        return [Thing(public()[name])]
    classes = [
        cls for cls in public().values() if inspect.isclass(cls) and cls.__module__.startswith("gnc_opt")
    ]
    members = [thing for cls in classes for thing in _attribute(Thing(cls, instance=True), name)]
    members += [Thing(getattr(module, name)) for module in _problem_modules() if hasattr(module, name)]
    if not members and hasattr(builtins, name):
        return [Thing(getattr(builtins, name))]
    if not members:
        raise NameError(f"nothing public is called '{name}'")
    return members


@cache
def _problem_modules() -> tuple[ModuleType, ...]:
    paths = (ROOT / "problems").rglob("*.py")
    names = (".".join(path.relative_to(ROOT).with_suffix("").parts) for path in paths)
    return tuple(
        importlib.import_module(name.removesuffix(".__init__")) for name in names if "__main__" not in name
    )


def _attribute(owner: Thing, name: str) -> list[Thing]:
    value = owner.value
    if isinstance(value, ModuleType):
        found = [Thing(getattr(value, name))] if hasattr(value, name) else []
        with contextlib.suppress(ImportError):  # a package may have the name of a function, as refine does
            found.append(Thing(importlib.import_module(f"{value.__name__}.{name}")))
        return found
    if not inspect.isclass(value):
        return []
    if isinstance(value, enum.EnumMeta) and name in value.__members__:
        return [Thing(value, instance=True)]
    member = inspect.getattr_static(value, name, None)
    if inspect.isfunction(member) or isinstance(member, (staticmethod, classmethod)):
        return [Thing(getattr(member, "__func__", member))]
    getter = getattr(member, "fget", None) or getattr(member, "func", None)
    if getter is not None:
        return [_result(getter)]
    hints = {k: v for base in value.__mro__ for k, v in vars(base).get("__annotations__", {}).items()}
    if name in hints or member is not None:
        return [Thing(None, instance=True)]
    return []


def _resolve_call(node: ast.Call) -> list[Thing]:
    things = resolve(node.func)
    if all(thing.value is None or thing.instance for thing in things):
        return [Thing(None, instance=True)]  # a signal at some time
    mistakes, results = [], []
    for thing in things:
        try:
            _bind(thing.value, node)
        except (TypeError, ValueError) as error:
            mistakes.append(str(error))
        else:
            results.append(_result(thing.value))
    if not results:
        raise NameError(f"'{ast.unparse(node.func)}' is not called like this: {mistakes[0]}")
    return results


def _bind(function: Any, node: ast.Call) -> None:
    """Raise TypeError unless the arguments fit; `...` stands for any positional ones."""
    if inspect.isbuiltin(function):
        return  # Python 3.10 knows no signature of `print`
    signature = inspect.signature(function)
    names = [p for p in signature.parameters.values() if p.name != "self"]
    positional = [a for a in node.args if not (isinstance(a, ast.Constant) and a.value is ...)]
    keywords = {keyword.arg: ... for keyword in node.keywords if keyword.arg}
    signature.replace(parameters=names).bind_partial(*positional, **keywords)


def _result(function: Any) -> Thing:
    """What a call returns, by its annotation."""
    if inspect.isclass(function):
        return Thing(function, instance=True)
    try:
        hint = typing.get_type_hints(function).get("return")
    except (NameError, TypeError):
        hint = None
    return Thing(hint if inspect.isclass(hint) else None, instance=True)


def _check_option(name: str, value: ast.expr) -> None:
    """Raise NameError unless some callable has this parameter, and permits this value."""
    hints = [hint for function in _callables() if (hint := _hint(function, name)) is not None]
    if not hints:
        raise NameError(f"nothing has an option '{name}'")
    if isinstance(value, ast.Call):
        resolve(value)
    if isinstance(value, ast.Constant) and isinstance(value.value, str):
        fitting = re.compile(rf"\bstr\b|\bAny\b|{re.escape(repr(value.value))}")
        if value.value not in source_names() or not any(fitting.search(str(hint)) for hint in hints):
            raise NameError(f"the option '{name}' has no value {ast.unparse(value)}")


@cache
def _callables() -> tuple[Any, ...]:
    values = [*public().values()]
    for module in _problem_modules():
        values += [v for v in vars(module).values() if getattr(v, "__module__", "") == module.__name__]
    functions = [v for v in values if inspect.isfunction(v)]
    for cls in (v for v in values if inspect.isclass(v)):
        functions += [m for m in vars(cls).values() if inspect.isfunction(m)]
    return tuple(functions)


def _hint(function: Any, name: str) -> Any:
    """The annotation of a parameter; None without such a parameter."""
    if name not in inspect.signature(function).parameters:
        return None
    try:
        return typing.get_type_hints(function).get(name, Any)
    except (NameError, TypeError):
        return Any
