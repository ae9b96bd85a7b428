"""Exceptions and warnings; each message is one sentence with cause, location and remedy."""

from __future__ import annotations

import difflib
import reprlib
import sys
import textwrap
import warnings
from collections.abc import Iterable, Sequence


class GncOptError(Exception):
    """Base class of all errors raised by gnc_opt."""


class ModelError(GncOptError, ValueError):
    """Invalid dynamics: missing or duplicate equations, wrong sizes, foreign symbols."""


class ProblemError(GncOptError, ValueError):
    """Invalid optimal control problem: names, sizes, bounds, values or functions."""


class ArgumentError(GncOptError, ValueError):
    """Invalid argument: a solver option, a scheme, an evaluation time, an object of the wrong class."""


class UnknownNameError(ModelError, ProblemError, KeyError):
    """Undeclared name; the message suggests a declared one."""

    def __str__(self) -> str:
        return str(self.args[0])


class UnknownAttributeError(GncOptError, AttributeError):
    """Access to an attribute that does not exist; the message suggests a valid one."""


class DesignError(GncOptError, ValueError):
    """A controller cannot be designed because of the plant, the weights or the control authority."""


class ProblemWarning(UserWarning):
    """A part of a problem that is valid but probably unintended."""


_OURS = ("gnc_opt", "contextlib")
"""Packages whose frames are skipped to find the user's line, including those of decorators."""


def warn_user(message: str) -> None:
    """Issue a `ProblemWarning` that points to the line of the user's call."""
    depth = 1
    while sys._getframe(depth).f_globals.get("__name__", "").partition(".")[0] in _OURS:
        depth += 1
    warnings.warn(message, ProblemWarning, stacklevel=depth + 1)


def quote_value(value: object) -> str:
    """Return a short one-line form of a value for messages."""
    return " ".join(reprlib.repr(value).split())


def format_exception(error: BaseException) -> str:
    """Return an error of any class on one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"


def suggest_similar_name(name: str, known: Iterable[str]) -> str:
    """Return "did you mean 'x'?" if a known name is similar, else the list of known names."""
    names = list(known)
    lowered = {candidate.lower(): candidate for candidate in names}
    near = difflib.get_close_matches(str(name).lower(), lowered, n=1, cutoff=0.6)
    if near:
        return f"did you mean '{lowered[near[0]]}'?"
    shown = textwrap.shorten(", ".join(names), 300, placeholder=" ...")
    return f"known: {shown}." if names else "none is declared."


def unknown_name_error(what: str, name: object, where: str, known: Iterable[str]) -> UnknownNameError:
    """Return the error for an undeclared name: ``unknown_name_error("state", "vv", "model 'cart'", ...)``."""
    if not isinstance(name, str):
        return UnknownNameError(
            f"{where} has no {what} {quote_value(name)}: give a name, {suggest_similar_name('', known)}"
        )
    return UnknownNameError(f"{where} has no {what} '{name}': {suggest_similar_name(name, known)}")


def suggest_model_symbol(name: str, known: Sequence[str]) -> str:
    """Return a suggestion for a symbol of another model: the same name in this model, or `suggest_similar_name`."""
    own = name if name in known else name.rpartition("_")[0]
    if own not in known:
        return suggest_similar_name(name, known)
    return f"it is another model's, write model.symbol('{own}') for the one here."
