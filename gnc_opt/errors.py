"""The errors of gnc_opt: each message is one sentence with the cause, its place and the remedy."""

from __future__ import annotations

import difflib
import reprlib
import sys
import warnings
from collections.abc import Iterable, Sequence


class GncOptError(Exception):
    """Base class of every error that gnc_opt raises on purpose."""


class ModelError(GncOptError, ValueError):
    """The dynamics are wrong: missing, duplicate, of the wrong size or with a foreign symbol."""


class ProblemError(GncOptError, ValueError):
    """The optimal control problem is wrong: names, sizes, bounds, values or functions."""


class ArgumentError(GncOptError, ValueError):
    """An argument is wrong: a solver option, a scheme, a time to evaluate at, an object of the wrong kind."""


class UnknownNameError(ModelError, ProblemError, KeyError):
    """An undeclared name; the message suggests the nearest declared one."""

    def __str__(self) -> str:
        return str(self.args[0])


class UnknownAttributeError(GncOptError, AttributeError):
    """An attribute that does not exist, read or assigned; the message offers the nearest one."""


class DesignError(GncOptError, ValueError):
    """A controller cannot be designed: the plant, the weights or the authority do not allow it."""


class ProblemWarning(UserWarning):
    """Something in a problem that is legal and probably not meant."""


_OURS = ("gnc_opt", "contextlib")
"""Packages whose frames are no user's: what decorates functions of ours stands between them."""


def warn_user(message: str) -> None:
    """Issue a `ProblemWarning` that points to the user's line, however deep in gnc_opt it arises."""
    depth = 1
    while sys._getframe(depth).f_globals.get("__name__", "").partition(".")[0] in _OURS:
        depth += 1
    warnings.warn(message, ProblemWarning, stacklevel=depth + 1)


def shown(value: object) -> str:
    """Return a short form of a value on one line, for messages."""
    return " ".join(reprlib.repr(value).split())


def format_error(error: BaseException) -> str:
    """Return an error of any kind on one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return "did you mean 'x'?" if a known name is near, else the list of the known names."""
    names = list(known)
    lowered = {candidate.lower(): candidate for candidate in names}
    near = difflib.get_close_matches(str(name).lower(), lowered, n=1, cutoff=0.6)
    if near:
        return f"did you mean '{lowered[near[0]]}'?"
    return f"known: {', '.join(names)}." if names else "none is declared."


def unknown_name(what: str, name: object, where: str, known: Iterable[str]) -> UnknownNameError:
    """Return the error for an undeclared name, e.g. ``unknown_name("state", "vv", "model 'cart'", ...)``."""
    if not isinstance(name, str):
        return UnknownNameError(
            f"{where} has no {what} {shown(name)}: give a name, {did_you_mean('', known)}"
        )
    return UnknownNameError(f"{where} has no {what} '{name}': {did_you_mean(name, known)}")


def suggest_symbol(name: str, known: Sequence[str]) -> str:
    """Say which symbol is meant by one of another model: its namesake here, or `did_you_mean`."""
    own = name if name in known else name.rpartition("_")[0]
    if own not in known:
        return did_you_mean(name, known)
    return f"it is another model's, write model.symbol('{own}') for the one here."
