"""Template problem files for ``gnc-opt new``, one per kind; each can be solved and verified without changes."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from gnc_opt.errors import GncOptError

KINDS = ("one-phase", "two-phase", "attitude", "landing")
"""Kinds of templates, the default first."""


def write_template_file(name: str | Path, kind: str = KINDS[0]) -> Path:
    """Write a problem file from a template and return its path.

    Parameters
    ----------
    name : str or Path
        File name in an existing folder; ``.py`` is added if it is missing.
    kind : str
        One of `KINDS`.

    Raises
    ------
    GncOptError
        The file exists, its folder does not exist, or the name is not a file name.
    """
    path = Path(name)
    if not path.name or path.name.startswith("."):
        raise GncOptError(f"'{name}' names no file: write gnc-opt new NAME.")
    path = path if path.suffix == ".py" else path.with_name(f"{path.name}.py")
    if not path.parent.is_dir():
        raise GncOptError(f"the folder of '{path}' does not exist: create it, or choose another place.")
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(read_template_text(kind))
    except FileExistsError as error:
        raise GncOptError(f"'{path}' exists already and was not changed: choose another name.") from error
    return path


def read_template_text(kind: str) -> str:
    """Return the text of a template, ``kind`` one of `KINDS`."""
    file = f"{kind.replace('-', '_')}.py"
    return resources.files(__name__).joinpath(file).read_text(encoding="utf-8")
