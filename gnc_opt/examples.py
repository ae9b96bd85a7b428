"""The problems that come with gnc_opt: found where they are installed, listed, and run as in the repository."""

from __future__ import annotations

import ast
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from types import ModuleType

from gnc_opt.errors import GncOptError, unknown_name

_HOLDERS = (Path(__file__).parent / "shipped", Path(__file__).parents[1])
"""Where the package ``problems`` may lie: inside an installed gnc_opt, or beside it in the repository."""


@dataclass(frozen=True)
class Example:
    """A problem file in a folder of its trade, or a system of several files in a folder of its own.

    Attributes
    ----------
    path : Path
        Of the file, or of the system's folder.
    problems : Path
        The folder of all problems.
    """

    path: Path
    problems: Path

    @property
    def name(self) -> str:
        """By which it is run."""
        return self.path.stem

    @property
    def is_system(self) -> bool:
        """Whether it is a folder."""
        return self.path.is_dir()

    @property
    def import_name(self) -> str:
        """The name of its module, such as ``problems.classics.zermelo``."""
        return ".".join(("problems", *self.path.relative_to(self.problems).with_suffix("").parts))

    @property
    def module(self) -> ModuleType:
        """Its module: those of the problems import each other as parts of the package ``problems``."""
        holder = str(self.problems.parent)
        if holder not in sys.path:
            sys.path.insert(0, holder)
        return import_module(self.import_name)

    @cached_property
    def statement(self) -> str:
        """Its docstring: what is asked, what it teaches, and where the answer is known from."""
        source = self.path / "__init__.py" if self.is_system else self.path
        return ast.get_docstring(ast.parse(source.read_text(encoding="utf-8"))) or ""

    @property
    def title(self) -> str:
        """The first line of the statement."""
        return self.statement.partition("\n")[0].rstrip(".")

    def run(self, arguments: Sequence[str] = ()) -> int:
        """Solve, judge, compare with what is known and print; return the exit code.

        Parameters
        ----------
        arguments : sequence of str
            Options of the problem's own command line, such as ``--json OUT``.
        """
        return int(self.module.main(arguments))


def examples() -> list[Example]:
    """Return every problem, files first, each by name.

    Raises
    ------
    GncOptError
        The problems are not where gnc_opt is.
    """
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
    raise GncOptError("the problems that come with gnc_opt are not beside it: install gnc_opt again.")


def example(name: str) -> Example:
    """Return the problem of this name; raise `UnknownNameError` if there is none."""
    found = {each.name: each for each in examples()}
    if name not in found:
        raise unknown_name("example", name, "gnc_opt", found)
    return found[name]
