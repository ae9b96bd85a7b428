"""Template problem files, one per kind, that ``gnc-opt new`` copies; each can be solved and verified
unchanged.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from gnc_opt.errors import GncOptError

KINDS = ("one-phase", "two-phase", "attitude", "landing")
"""Kinds of templates, the usual one first."""


def write_template(name: str | Path, kind: str = KINDS[0]) -> Path:
    """Write a problem file to start from and return its path.

    Parameters
    ----------
    name : str or Path
        Of the file, in a folder that exists; ``.py`` is added if it is missing.
    kind : str
        One of `KINDS`.

    Raises
    ------
    GncOptError
        The file exists already, its folder does not, or the name is none of a file.
    """
    path = Path(name)
    if not path.name or path.name.startswith("."):
        raise GncOptError(f"'{name}' names no file: write gnc-opt new NAME.")
    path = path if path.suffix == ".py" else path.with_name(f"{path.name}.py")
    if not path.parent.is_dir():
        raise GncOptError(f"the folder of '{path}' does not exist: create it, or choose another place.")
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(template_text(kind))
    except FileExistsError as error:
        raise GncOptError(f"'{path}' exists already and is left as it is: choose another name.") from error
    return path


def template_text(kind: str) -> str:
    """Return the text of the template of a kind, one of `KINDS`."""
    file = f"{kind.replace('-', '_')}.py"
    return resources.files(__name__).joinpath(file).read_text(encoding="utf-8")
