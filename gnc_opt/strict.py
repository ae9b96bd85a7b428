"""Objects that refuse misspelt attributes instead of swallowing them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from gnc_opt.errors import UnknownAttributeError, did_you_mean


class Strict:
    """Base of the classes that a user's script talks to; they name their attributes in ``__slots__``.

    Reading or assigning any other attribute raises `UnknownAttributeError`, which says what was probably meant.
    """

    __slots__ = ()

    def __setattr__(self, name: str, value: Any) -> None:
        if name in type(self).__slots__:
            object.__setattr__(self, name, value)
        elif callable(getattr(type(self), name, None)):
            raise UnknownAttributeError(f"{_called(self)} is told by calling {name}(...), not by assigning to it.")
        elif hasattr(type(self), name):
            raise UnknownAttributeError(f"'{name}' of {_called(self)} follows from its declarations: change those.")
        else:
            raise _unknown(self, name)

    if not TYPE_CHECKING:  # a type checker must go on refusing misspelt attributes by itself

        def __getattr__(self, name: str) -> Any:
            raise _unknown(self, name)


def _unknown(instance: Strict, name: str) -> UnknownAttributeError:
    others = [c.__name__ for c in Strict.__subclasses__() if not name.startswith("_") and hasattr(c, name)]
    if others:
        return UnknownAttributeError(f"{_called(instance)} has no '{name}': call it on a {' or a '.join(others)}.")
    public = [known for known in dir(type(instance)) if not known.startswith("_")]
    return UnknownAttributeError(f"{_called(instance)} has no '{name}': {did_you_mean(name, public)}")


def _called(instance: Strict) -> str:
    kind = type(instance).__name__.lower()
    # While an object is being built or copied, it may not have its name yet.
    name = getattr(instance, "name", None) if "name" != getattr(instance, "__missing__", "name") else None
    return f"{kind} '{name}'"
