"""Validation of arguments and attributes: invalid values and misspelt names raise a one-sentence error."""

from __future__ import annotations

import contextlib
import difflib
import functools
import inspect
import keyword
import numbers
import re
from collections.abc import Callable, Mapping, Sequence
from types import FunctionType, MemberDescriptorType
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, cast

import casadi as ca
import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.errors import (
    ArgumentError,
    GncOptError,
    UnknownAttributeError,
    quote_value,
    suggest_similar_name,
)
from gnc_opt.renamed_public_names import GUESSED_MEMBERS, RENAMED_MEMBERS, RENAMED_PARAMETERS

P = ParamSpec("P")
T = TypeVar("T")


def suggest_keywords(function: Callable[P, T]) -> Callable[P, T]:
    """Decorate a function so that its `TypeError` for an unknown keyword suggests a valid one."""

    @functools.wraps(function)
    def call_with_keyword_suggestion(*arguments: P.args, **keywords: P.kwargs) -> T:
        try:
            return function(*arguments, **keywords)
        except TypeError as error:
            inside = error.__traceback__ and error.__traceback__.tb_next
            if inside or "unexpected keyword argument" not in str(error):
                raise
            known = [p.name for p in inspect.signature(function).parameters.values() if p.name != "self"]
            unknown = next(name for name in keywords if name not in known)
            text, now = str(error).split(". Did you mean")[0], RENAMED_PARAMETERS.get(unknown)
            remedy = f"it is now {now!r}." if now in known else suggest_similar_name(unknown, known)
            raise TypeError(f"{text}: {remedy}") from None

    return call_with_keyword_suggestion


class StrictAttributes:
    """Base of public classes: an unknown attribute or keyword raises an error that suggests a valid name."""

    __slots__ = ()

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        for name, value in list(vars(cls).items()):
            if isinstance(value, FunctionType) and not name.startswith("_"):
                setattr(cls, name, suggest_keywords(value))

    def __dir__(self) -> list[str]:
        return [name for name in object.__dir__(self) if not name.startswith("_")]

    def __setattr__(self, name: str, value: Any) -> None:
        known = getattr(type(self), name, None)
        if isinstance(known, MemberDescriptorType) or hasattr(self, "__dict__"):
            object.__setattr__(self, name, value)
        elif callable(known):
            raise UnknownAttributeError(
                f"{_format_class_and_object_name(self)} sets {name} by a method call: write {name}(...)."
            )
        elif known is not None:
            raise UnknownAttributeError(
                f"'{name}' of {_format_class_and_object_name(self)} follows from its declarations: change those."
            )
        else:
            raise _build_unknown_attribute_error(self, name)

    if not TYPE_CHECKING:  # type checkers report misspelt attributes themselves

        def __getattr__(self, name: str) -> Any:
            if name.startswith("__"):  # Python probes for protocols, most of them missing
                raise AttributeError(name)
            raise _build_unknown_attribute_error(self, name)


def _build_unknown_attribute_error(instance: StrictAttributes, name: str) -> UnknownAttributeError:
    member = f"{type(instance).__name__}.{name}"
    public = sorted({known for known in object.__dir__(instance) if not known.startswith("_")})
    owners = {c.__name__ for c in _find_concrete_subclasses(StrictAttributes) if hasattr(c, name)}
    if member in RENAMED_MEMBERS:
        remedy = f"it is now '{RENAMED_MEMBERS[member]}'."
    elif member in GUESSED_MEMBERS:
        remedy = f"use {GUESSED_MEMBERS[member]}."
    elif owners and not name.startswith("_") and not difflib.get_close_matches(name, public, cutoff=0.85):
        remedy = f"it belongs to a {' or a '.join(sorted(owners))}."
    else:
        remedy = suggest_similar_name(name, public)
    return UnknownAttributeError(f"{_format_class_and_object_name(instance)} has no '{name}': {remedy}")


def _format_class_and_object_name(instance: StrictAttributes) -> str:
    kind = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", type(instance).__name__).lower()
    try:
        return f"{kind} '{object.__getattribute__(instance, 'name')}'"
    except AttributeError:  # without a name, or in the constructor
        return kind


def _find_concrete_subclasses(kind: type) -> list[type]:
    below: list[type] = kind.__subclasses__()
    return [leaf for c in below for leaf in _find_concrete_subclasses(c)] if below else [kind]


ErrorType = type[GncOptError]


def require_type(value: Any, kind: type, what: str, remedy: str) -> Any:
    """Return ``value`` if it has the given class; raise `ArgumentError` with the remedy otherwise."""
    if not isinstance(value, kind):
        raise ArgumentError(f"{what} must be of type {kind.__name__}, not {type(value).__name__}: {remedy}.")
    return value


def read_optional_mapping(value: Any, what: str, remedy: str) -> Mapping[Any, Any]:
    """Return an optional mapping, empty for ``None``; raise `ArgumentError` with the remedy for other values."""
    return {} if value is None else cast(Mapping[Any, Any], require_type(value, Mapping, what, remedy))


def require_distinct_names(names: Sequence[str], what: str) -> None:
    """Raise `ArgumentError` if a name occurs twice; ``what`` is for example ``"events of a loop"``."""
    for name in names:
        if names.count(name) > 1:
            raise ArgumentError(f"two {what} are called '{name}': rename one.")


def read_variable_name(name: object, what: str, error: ErrorType = ArgumentError) -> str:
    """Return a name that is a valid keyword argument, for variables and phases."""
    if not isinstance(name, str) or not name.isidentifier():
        raise error(
            f"{quote_value(name)} cannot be the name of a {what}: use letters, digits and underscores."
        )
    if keyword.iskeyword(name) or name == "time":
        raise error(f"'{name}' is a reserved word and cannot be the name of a {what}: write '{name}_'.")
    return name


def read_display_name(
    name: object,
    what: str,
    error: ErrorType = ArgumentError,
    *,
    instead: str = "give its name first, as text",
) -> str:
    """Return a name for results and reports: any text without brackets and line breaks."""
    article = "an" if what[:1] in "aeiou" else "a"
    if not isinstance(name, str):
        raise error(f"{quote_value(name)} cannot be the name of {article} {what}: {instead}.")
    if not name.strip() or "[" in name or not name.isprintable():
        raise error(
            f"{quote_value(name)} cannot be the name of {article} {what}: give a text without brackets and line breaks."
        )
    return name


def read_integer(value: Any, what: str, least: int, error: ErrorType = ArgumentError) -> int:
    """Return a whole number that is not less than ``least``."""
    if not isinstance(value, numbers.Integral) or isinstance(value, bool) or value < least:
        raise error(f"{what} is {quote_value(value)}: give an integer >= {least}.")
    return int(value)


def read_positive_number(
    value: Any, what: str, error: ErrorType = ArgumentError, *, or_zero: bool = False
) -> float:
    """Return a finite number > 0 (or >= 0)."""
    if isinstance(value, numbers.Real) and not isinstance(value, bool):
        with contextlib.suppress(OverflowError):  # an integer beyond 1e308
            number = float(value)
            if np.isfinite(number) and (number > 0 or (or_zero and number == 0)):
                return number
    raise error(f"{what} is {quote_value(value)}: give a finite number {'>=' if or_zero else '>'} 0.")


def read_probability(value: Any, what: str) -> float:
    """Return a number in (0, 1)."""
    if isinstance(value, numbers.Real) and not isinstance(value, bool) and 0 < float(value) < 1:
        return float(value)
    raise ArgumentError(f"{what} is {quote_value(value)}: give a number between 0 and 1.")


def read_float_array(value: Any, what: str, error: ErrorType = ArgumentError) -> Array:
    """Return numbers as a new float array; raise an error for text, ``None`` and expressions."""
    if type(value) is np.ndarray and value.dtype == float:  # the most frequent case
        return value.copy()
    if isinstance(value, ca.DM):
        value = value.full()
    if _contains_casadi_symbols(value):
        raise error(f"{what} is the expression {quote_value(value)} where numbers are needed: give numbers.")
    try:
        array = np.asarray(value)
        real = array.dtype.kind in "biuf" or all(isinstance(entry, numbers.Real) for entry in array.flat)
        if real:
            return np.array(array, dtype=float)
    except (TypeError, ValueError, OverflowError):  # ragged rows, or objects without conversion
        pass
    raise error(f"{what} is {quote_value(value)}, which is not a number or an array of numbers.")


def _contains_casadi_symbols(value: Any) -> bool:
    """Return whether a value contains CasADi symbols, which NumPy would convert with warnings."""
    if isinstance(value, (list, tuple)):
        return any(_contains_casadi_symbols(entry) for entry in value)
    return isinstance(value, (ca.SX, ca.MX))
