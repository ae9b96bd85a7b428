"""Problem files: any Python file with ``build(**options) -> Problem``.

Two more names are looked for: ``MESH`` (a mesh, ``"20x3"`` or a mapping from phase to mesh) is the default
mesh, and ``figures(solution, directory)`` draws the problem's own figures for a report.
"""

from __future__ import annotations

import importlib.util
import inspect
import json
import sys
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from gnc_opt.errors import GncOptError, did_you_mean
from gnc_opt.problem.problem import Problem

_WORDS: dict[str, Any] = {"true": True, "false": False, "none": None, "null": None}


class ProblemFileError(GncOptError):
    """A problem file, or an option given to it, is wrong; the message names the file and the line."""


@dataclass(frozen=True)
class ProblemFile:
    """A problem file that has been run.

    Attributes
    ----------
    path : Path
    module : module
    """

    path: Path
    module: ModuleType

    @property
    def mesh(self) -> Any:
        """The file's default mesh; None leaves it to `solve`."""
        return getattr(self.module, "MESH", None)

    @property
    def figures(self) -> Any:
        """The file's ``figures(solution, directory)``, or None."""
        return getattr(self.module, "figures", None)

    @property
    def options(self) -> dict[str, inspect.Parameter]:
        """The options that ``build`` takes, by name."""
        return dict(inspect.signature(self.module.build).parameters)

    def build(self, options: Mapping[str, Any]) -> Problem:
        """Return the problem for these options.

        Raises
        ------
        ProblemFileError
            Unknown or missing options, ``build`` fails, or returns something else than a Problem.
        """
        self._check_options(options)
        with _blaming(self.path, "build()"):
            problem = self.module.build(**options)
        if not isinstance(problem, Problem):
            raise ProblemFileError(
                f"{self.path}: build() returned {type(problem).__name__}, not a Problem: end it with return."
            )
        return problem

    def _check_options(self, given: Mapping[str, Any]) -> None:
        known = self.options
        kinds = inspect.Parameter
        named = [n for n, p in known.items() if p.kind not in (kinds.VAR_KEYWORD, kinds.VAR_POSITIONAL)]
        takes_any = any(p.kind is kinds.VAR_KEYWORD for p in known.values())
        for name in given:
            if name not in named and not takes_any:
                raise ProblemFileError(
                    f"{self.path}: build() has no option '{name}': {did_you_mean(name, named)}"
                )
        missing = [n for n in named if known[n].default is kinds.empty and n not in given]
        if missing:
            raise ProblemFileError(
                f"{self.path}: build() needs the option '{missing[0]}': add --set {missing[0]}=..."
            )


def load_problem_file(path: str | Path) -> ProblemFile:
    """Run a problem file.

    Its folder and the folder above can be imported from, so ``problems/b.py`` may say ``import a`` or
    ``from problems import a``.

    Raises
    ------
    ProblemFileError
        No such file, not Python, an error while it runs, or no ``build`` in it.
    """
    file = Path(path)
    if not file.is_file():
        what = "is a folder" if file.is_dir() else "does not exist"
        raise ProblemFileError(f"problem file '{path}' {what}: name a Python file with a build() function.")
    for folder in (file.resolve().parent.parent, file.resolve().parent):
        if str(folder) not in sys.path:
            sys.path.insert(0, str(folder))
    # A prefix, so that a file called numpy.py does not replace numpy.
    spec = importlib.util.spec_from_file_location(f"_problem_file_{file.stem}", file)
    if spec is None or spec.loader is None:
        raise ProblemFileError(f"problem file '{path}' is not a Python file: its name must end in .py.")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    with _blaming(file, "the file"):
        spec.loader.exec_module(module)
    if not callable(getattr(module, "build", None)):
        functions = [n for n, v in vars(module).items() if inspect.isfunction(v) and not n.startswith("_")]
        raise ProblemFileError(
            f"{path} has no function build() that returns the Problem: {did_you_mean('build', functions)}"
        )
    return ProblemFile(file, module)


def parse_setting(text: str) -> tuple[str, Any]:
    """Read ``NAME=VALUE``: an integer, float, true/false, none, JSON list, or else a string.

    Raises
    ------
    ProblemFileError
        No ``=``, a name that is no identifier, or a list that is not valid JSON.
    """
    name, equals, value = text.partition("=")
    name = name.strip()
    if not equals or not name.isidentifier():
        raise ProblemFileError(f"--set {text!r} is not understood: write NAME=VALUE, e.g. --set case=2.")
    return name, _parse_value(value.strip(), text)


def _parse_value(value: str, text: str) -> Any:
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
def _blaming(path: Path, what: str) -> Iterator[None]:
    """Turn whatever a user's code raises into one sentence that names the line."""
    try:
        yield
    except ProblemFileError:
        raise
    except SystemExit as error:
        raise ProblemFileError(f"{path}: {what} ends the program (exit code {error.code}).") from error
    except Exception as error:
        line = _line_in(path, error)
        place = f"{path}, line {line}" if line else str(path)
        kind = "" if isinstance(error, GncOptError) else f"{type(error).__name__}: "
        message = error.msg if isinstance(error, SyntaxError) else str(error)
        raise ProblemFileError(f"{place}: {kind}{message}") from error


def _line_in(path: Path, error: BaseException) -> int | None:
    """The last line of the file that the error passed through."""
    if isinstance(error, SyntaxError) and error.filename and Path(error.filename).resolve() == path.resolve():
        return error.lineno
    frames = traceback.extract_tb(error.__traceback__)
    lines = [f.lineno for f in frames if Path(f.filename).resolve() == path.resolve()]
    return lines[-1] if lines else None
