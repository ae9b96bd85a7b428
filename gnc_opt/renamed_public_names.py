"""Former public names and their replacements, for error messages and the page "Names changed in 0.4"."""

from __future__ import annotations

import json
from enum import Enum
from pathlib import Path
from typing import NoReturn

from gnc_opt.errors import GncOptError

_NAMES = json.loads(Path(__file__).with_name("renamed_public_names.json").read_text(encoding="utf-8"))

RENAMED: dict[str, str] = _NAMES["renamed"]
"""Present full name of each former full name."""

REMOVED: dict[str, str] = _NAMES["removed"]
"""Replacement of each removed full name."""

RENAMED_MEMBERS: dict[str, str] = _NAMES["members"]
"""Present member of each former one of a model, phase or problem, ``Class.name``."""

GUESSED_MEMBERS: dict[str, str] = _NAMES["guessed members"]
"""Present member or call for names of other tools, ``Class.name``."""

RENAMED_STATUS_WORDS: dict[str, str] = _NAMES["status words"]
"""Present word of each former status word: the member name in lower case."""

RENAMED_PARAMETERS = {"experiment": "scenario", "judge": "measures"}
"""Present name of each former parameter."""


class StatusWord(Enum):
    """Enumeration of statuses that accepts former words, so that older files can be loaded."""

    @classmethod
    def _missing_(cls, value: object) -> Enum | None:
        return cls._value2member_map_.get(RENAMED_STATUS_WORDS.get(str(value)))


class RenamedError(GncOptError, ImportError):
    """Use of a former name; an `ImportError`, because Python replaces the text of an `AttributeError`."""


def raise_missing_name_error(module: str, name: str) -> NoReturn:
    """Raise the error of a name that the module lacks: `RenamedError` with the replacement if it had the name."""
    former = f"{module}.{name}"
    if former in RENAMED:
        raise RenamedError(
            f"{former} is now {RENAMED[former]}: see the page 'Names changed in 0.4' of the documentation."
        )
    if former in REMOVED:
        raise RenamedError(f"{former} is removed: use {REMOVED[former]}.")
    raise AttributeError(f"module {module!r} has no attribute {name!r}")
