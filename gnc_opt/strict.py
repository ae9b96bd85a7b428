"""Objects that refuse misspelt attributes instead of swallowing them."""

from __future__ import annotations

from types import MemberDescriptorType
from typing import TYPE_CHECKING, Any

from gnc_opt.errors import UnknownAttributeError, did_you_mean


class Strict:
    """Base of the classes that a user's script talks to; they list their attributes in ``__slots__``.

    Reading or assigning any other attribute raises `UnknownAttributeError`, which says what was probably
    meant. A subclass without ``__slots__`` may assign what it likes.
    """

    __slots__ = ()

    def __setattr__(self, name: str, value: Any) -> None:
        known = getattr(type(self), name, None)
        if isinstance(known, MemberDescriptorType) or hasattr(self, "__dict__"):
            object.__setattr__(self, name, value)
        elif callable(known):
            raise UnknownAttributeError(f"{_called(self)} learns its {name} by a call: write {name}(...).")
        elif known is not None:
            raise UnknownAttributeError(
                f"'{name}' of {_called(self)} follows from its declarations: change those."
            )
        else:
            raise _unknown(self, name)

    if not TYPE_CHECKING:  # a type checker must go on refusing misspelt attributes by itself

        def __getattr__(self, name: str) -> Any:
            if name.startswith("__"):  # Python asks for its protocols, and expects most of them to be missing
                raise AttributeError(name)
            raise _unknown(self, name)


def _unknown(instance: Strict, name: str) -> UnknownAttributeError:
    public = [known for known in dir(type(instance)) if not known.startswith("_")]
    owners = [c.__name__ for c in _leaves(Strict) if not name.startswith("_") and hasattr(c, name)]
    remedy = f"it belongs to a {' or a '.join(owners)}." if owners else did_you_mean(name, public)
    return UnknownAttributeError(f"{_called(instance)} has no '{name}': {remedy}")


def _called(instance: Strict) -> str:
    kind = type(instance).__name__.lower()
    try:
        return f"{kind} '{object.__getattribute__(instance, 'name')}'"
    except AttributeError:  # under construction
        return kind


def _leaves(kind: type) -> list[type]:
    """The classes below a class that have none below themselves: those that users meet."""
    below: list[type] = kind.__subclasses__()
    return [leaf for c in below for leaf in _leaves(c)] if below else [kind]
