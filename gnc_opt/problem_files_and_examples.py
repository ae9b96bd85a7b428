"""Problem files: Python files or packages with ``build(**options) -> Problem``, and the examples of gnc_opt.

Optional names: ``MESH`` is the default mesh, ``VIEW`` (a `gnc_opt.plot.View`) defines the 3-D motion in a report.
"""

from __future__ import annotations

import ast
import importlib.util
import inspect
import json
import re
import sys
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from gnc_opt.errors import GncOptError, suggest_similar_name, unknown_name_error
from gnc_opt.planning.problem.problem import Problem

_HOLDERS = (Path(__file__).parent / "shipped", Path(__file__).parents[1])
"""Possible locations of the package ``problems``: installed, or in the repository."""


@dataclass(frozen=True)
class Example:
    """Example problem: a file or a package at ``path`` below ``problems``."""

    path: Path
    problems: Path

    @property
    def name(self) -> str:
        """Name on the command line."""
        return self.path.stem

    @property
    def is_package(self) -> bool:
        """Whether the example is a package."""
        return self.path.is_dir()

    @property
    def module_name(self) -> str:
        """Module name, such as ``problems.classics.zermelo``."""
        return ".".join(("problems", *self.path.relative_to(self.problems).with_suffix("").parts))

    @property
    def module(self) -> ModuleType:
        """Module of the example, imported as part of the package ``problems``."""
        holder = str(self.problems.parent)
        if holder not in sys.path:
            sys.path.insert(0, holder)
        return import_module(self.module_name)

    @cached_property
    def module_docstring(self) -> str:
        """Docstring of the example: problem, purpose and source of the known result."""
        source = self.path / "__init__.py" if self.is_package else self.path
        return ast.get_docstring(ast.parse(source.read_text(encoding="utf-8"))) or ""

    @property
    def title(self) -> str:
        """First line of the docstring."""
        return self.module_docstring.partition("\n")[0].rstrip(".")

    def run(self, arguments: Sequence[str] = ()) -> int:
        """Solve, verify, compare with the known result and print; return the exit code."""
        if self.is_package:
            return int(import_module(f"{self.module.__name__}.__main__").main(arguments))
        return int(self.module.main(arguments))


def list_examples() -> list[Example]:
    """Return all examples, files first, sorted by name; raise `GncOptError` if they are not installed."""
    for holder in _HOLDERS:
        folder = holder / "problems"
        if (folder / "_example.py").is_file():
            systems = sorted(path.parent for path in folder.glob("*/__main__.py"))
            files = [
                path
                for path in folder.glob("*/*.py")
                if path.parent not in systems and path.name != "__init__.py"
            ]
            return [Example(path, folder) for path in (*sorted(files, key=lambda path: path.stem), *systems)]
    raise GncOptError("the problems that come with gnc_opt are missing: install gnc_opt again.")


def find_example(name: str) -> Example:
    """Return the example with this name; raise `UnknownNameError` if there is none."""
    found = {each.name: each for each in list_examples()}
    if name not in found:
        raise unknown_name_error("example", name, "gnc_opt", found)
    return found[name]


_INIT = "__init__.py"
_REMEDIES = {
    "Cannot compute the truth value": "(What a state will be is not known here: write casadi.if_else(condition, this, "
    "that), casadi.fmax(a, b) or casadi.fmin(a, b), or a phase per case.)",
    "Matrix product with incompatible dimensions": "(Vectors are columns: write a.T @ b, or casadi.dot(a, b).)",
    "overloaded function": "(Build vectors with casadi.vertcat(a, b) first.)",
}
"""Hints for expressions that CasADi rejects, by a part of its message."""

_WORDS: dict[str, Any] = {"true": True, "false": False, "none": None, "null": None}


class ProblemFileError(GncOptError):
    """Invalid problem file or option; the message contains file and line."""


@dataclass(frozen=True)
class ProblemFile:
    """Executed problem file; ``path`` is the file or the package folder."""

    path: Path
    module: ModuleType

    @property
    def default_mesh(self) -> Any:
        """Default mesh of the file; None: the default of `solve`."""
        return getattr(self.module, "MESH", None)

    @property
    def view(self) -> Any:
        """``VIEW`` of the file, or None; raises `ProblemFileError` for other values."""
        found = getattr(self.module, "VIEW", None)
        if found is None:
            return None
        from gnc_opt.plot.vehicle_motion_sampling import View  # after the file, which may not need matplotlib

        if not isinstance(found, View):
            raise ProblemFileError(
                f"{self.path}: VIEW is a {type(found).__name__}, not a View: write VIEW = View(position=...)."
            )
        return found

    def describe_problem_builder(self, chosen: Mapping[str, Any]) -> str:
        """Return the docstring of the module that defines ``build``, and the options with values and meaning."""
        owner = sys.modules.get(getattr(self.module.build, "__module__", ""), self.module)
        meanings, lines = inspect.getdoc(self.module.build) or "", []
        for name, option in self.builder_options.items():
            if (value := chosen.get(name, option.default)) is not option.empty:
                found = re.search(rf"^{name} : .*\n((?:    .*\n?)+)", meanings, re.MULTILINE)
                meaning = "" if found is None else ": " + " ".join(found[1].split())
                lines.append(f"``{name} = {value}``{meaning}")
        return "\n\n".join(
            [inspect.getdoc(owner) or "", *["**Options of this solution**"] * bool(lines), *lines]
        )

    @property
    def builder_options(self) -> dict[str, inspect.Parameter]:
        """Options of ``build`` by name."""
        return dict(inspect.signature(self.module.build).parameters)

    def build(self, options: Mapping[str, Any]) -> Problem:
        """Return the problem for these options; raise `ProblemFileError` for wrong ones, or if ``build`` fails."""
        self._check_options_of_problem_builder(options)
        with _add_failing_line_to_exceptions(self.path, "build()"):
            problem = self.module.build(**options)
        if not isinstance(problem, Problem):
            raise ProblemFileError(
                f"{self.path}: build() returned {type(problem).__name__}, not a Problem: end it with return."
            )
        return problem

    def _check_options_of_problem_builder(self, given: Mapping[str, Any]) -> None:
        known = self.builder_options
        kinds = inspect.Parameter
        named = [n for n, p in known.items() if p.kind not in (kinds.VAR_KEYWORD, kinds.VAR_POSITIONAL)]
        takes_any = any(p.kind is kinds.VAR_KEYWORD for p in known.values())
        for name in given:
            if name not in named and not takes_any:
                raise ProblemFileError(
                    f"{self.path}: build() has no option '{name}': {suggest_similar_name(name, named)}"
                )
        missing = [n for n in named if known[n].default is kinds.empty and n not in given]
        if missing:
            raise ProblemFileError(
                f"{self.path}: build() needs the option '{missing[0]}': add --set {missing[0]}=..."
            )


def load_problem_file(path: str | Path) -> ProblemFile:
    """Run a problem file, or import a problem package: a folder with ``__init__.py``.

    A file can import from its folder, the parent and the package root. A missing ``NAME.py`` is the package.

    Raises
    ------
    ProblemFileError
        No such file, not Python, an error while it runs, no ``build``, or a package hidden by another module.
    """
    source = _resolve_problem_path(Path(path))
    module = _import_problem_package(source) if source.is_dir() else _execute_problem_file(source)
    if not callable(getattr(module, "build", None)):
        functions = [n for n, v in vars(module).items() if inspect.isfunction(v) and not n.startswith("_")]
        raise ProblemFileError(
            f"{path} has no function build() that returns the Problem: {suggest_similar_name('build', functions)}"
        )
    return ProblemFile(source, module)


def _resolve_problem_path(path: Path) -> Path:
    if path.is_file():
        return path.parent if path.name == _INIT else path
    folder = path.with_suffix("") if path.suffix == ".py" else path
    if (folder / _INIT).is_file():
        return folder
    what = f"is a folder without {_INIT}" if path.is_dir() else "does not exist"
    raise ProblemFileError(
        f"problem file '{path}' {what}: name a Python file or a package with a build() function."
    )


def _execute_problem_file(file: Path) -> ModuleType:
    folder = file.resolve().parent
    _add_import_root_to_path(_find_import_root_folder(folder), folder.parent, folder)
    spec = importlib.util.spec_from_file_location(f"_problem_file_{file.stem}", file)
    if spec is None or spec.loader is None:
        raise ProblemFileError(f"problem file '{file}' is not a Python file: its name must end in .py.")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look up their module
    with _add_failing_line_to_exceptions(file, "the file"):
        spec.loader.exec_module(module)
    return module


def _import_problem_package(folder: Path) -> ModuleType:
    holder = _find_import_root_folder(folder.resolve())
    names = folder.resolve().relative_to(holder).parts
    _add_import_root_to_path(holder)
    with _add_failing_line_to_exceptions(folder, "the package"):
        outermost = importlib.import_module(names[0])
        if str(holder / names[0]) not in (str(Path(p).resolve()) for p in getattr(outermost, "__path__", [])):
            raise ProblemFileError(
                f"problem package '{folder}' is hidden by another module named '{names[0]}' "
                f"({getattr(outermost, '__file__', None) or 'built in'}): rename the folder."
            )
        return importlib.import_module(".".join(names))


def _find_import_root_folder(folder: Path) -> Path:
    """Return the nearest parent folder that is not a package, the root of module names."""
    return next((above for above in folder.parents if not (above / _INIT).is_file()), folder)


def _add_import_root_to_path(*folders: Path) -> None:
    for folder in folders:
        if str(folder) not in sys.path:
            sys.path.insert(0, str(folder))


def parse_build_option(text: str) -> tuple[str, Any]:
    """Parse ``NAME=VALUE``: an integer, float, true/false, none, JSON list or string; else `ProblemFileError`."""
    name, equals, value = text.partition("=")
    name = name.strip()
    if not equals or not name.isidentifier():
        raise ProblemFileError(f"--set {text!r} is not understood: write NAME=VALUE, e.g. --set case=2.")
    return name, _parse_option_value(value.strip(), text)


def _parse_option_value(value: str, text: str) -> Any:
    if value.lower() in _WORDS:
        return _WORDS[value.lower()]
    for kind in (int, float):
        try:
            return kind(value)
        except ValueError:
            continue
    if value[:1] in ("[", "{", '"'):
        try:
            return json.loads(value)
        except json.JSONDecodeError as error:
            raise ProblemFileError(f"--set {text!r}: the value is not valid JSON ({error.msg}).") from error
    return value


@contextmanager
def _add_failing_line_to_exceptions(path: Path, what: str) -> Iterator[None]:
    try:
        yield
    except ProblemFileError:
        raise
    except SystemExit as error:
        raise ProblemFileError(f"{path}: {what} ends the program (exit code {error.code}).") from error
    except Exception as error:
        place = _find_failing_source_line(path, error)
        raise ProblemFileError(f"{place}: {_format_error_message(error)}") from error


def _format_error_message(error: Exception) -> str:
    """Return the error message, with its type if it is not from gnc_opt, and a hint for rejected expressions."""
    if isinstance(error, GncOptError):
        return str(error)
    message = error.msg if isinstance(error, SyntaxError) else str(error)
    remedy = next((text for part, text in _REMEDIES.items() if part in message), None)
    if remedy is None:
        return f"{type(error).__name__}: {message}"
    return f"{type(error).__name__}: {' '.join(message.split())} {remedy}"


def _find_failing_source_line(path: Path, error: BaseException) -> str:
    passed = [(f.filename, f.lineno) for f in traceback.extract_tb(error.__traceback__)]
    if isinstance(error, SyntaxError) and error.filename:
        passed.append((error.filename, error.lineno))
    for name, line in reversed(passed):
        file = Path(name).resolve()
        if file.is_file() and file.is_relative_to(path.resolve()):
            return f"{path / file.relative_to(path.resolve())}, line {line}"
    return str(path)
