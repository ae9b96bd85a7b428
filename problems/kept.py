"""Results kept for the process, known by the values a call gives and not by how it spells them."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import cache, wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
Result = TypeVar("Result")


def kept(function: Callable[P, Result]) -> Callable[P, Result]:
    """Return the function with its results kept.

    To `functools.cache` a default that is given and one that is not are two calls, and so are a value by its place and
    by its name: what takes seconds would be done twice.
    """
    signature, results = inspect.signature(function), cache(function)

    @wraps(function)
    def known(*args: P.args, **kwargs: P.kwargs) -> Result:
        call = signature.bind(*args, **kwargs)
        call.apply_defaults()
        return results(*call.args, **call.kwargs)

    return known
