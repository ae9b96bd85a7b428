"""Shared: the one object that all tasks need, and the ways it gets to those who do them."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, Generic, NoReturn, TypeAlias, TypeVar

from gnc_opt.errors import GncOptError

Object = TypeVar("Object")

Parcel: TypeAlias = "Here[Object] | bytes"
"""What a worker opens to get at the object: the object itself, or a pickled function that makes it."""


@dataclass(frozen=True, eq=False)
class Shared(Generic[Object]):
    """An object for all tasks.

    Attributes
    ----------
    value : object
        For tasks in this process, and for processes that inherit its memory.
    name, remedy : str
        For the error if it cannot be sent to another process: what it is, and what to do about it.
    maker : callable, optional
        Makes it in another process; must be picklable. Without one it cannot be sent.

    Examples
    --------
    >>> from gnc_opt.workers import Shared
    >>> shared = Shared.picklable([1.0, 2.0], "the table", "give numbers")
    """

    value: Object
    name: str
    remedy: str
    maker: Callable[[], Object] | None = None

    @classmethod
    def picklable(cls, value: Object, name: str, remedy: str) -> Shared[Object]:
        """Return an object that travels by itself."""
        return cls(value, name, remedy, partial(_itself, value))

    @property
    def here(self) -> Here[Object]:
        """The parcel that stays in this process and in those that inherit its memory."""
        return Here(self.value, self._refusal(""))

    def packed(self) -> bytes:
        """Return the parcel for other processes.

        Raises
        ------
        GncOptError
            The object cannot be sent.
        """
        if self.maker is None:
            raise self._refusal("")
        try:
            return pickle.dumps(self.maker)
        except Exception as error:
            raise self._refusal(f" ({error})") from error

    def _refusal(self, why: str) -> GncOptError:
        return GncOptError(f"{self.name} cannot be sent to another process{why}: {self.remedy}.")


@dataclass(frozen=True, eq=False)
class Here(Generic[Object]):
    """A parcel that stays where it is; an executor that tries to send it gets the error."""

    value: Object
    error: GncOptError

    def __reduce__(self) -> NoReturn:
        raise self.error


def opened(parcel: Parcel[Any]) -> Any:
    """Return the object of a parcel; one that was sent is made once per process."""
    return parcel.value if isinstance(parcel, Here) else _made(parcel)


@lru_cache(maxsize=4)
def _made(parcel: bytes) -> Any:
    return pickle.loads(parcel)()


def _itself(value: Object) -> Object:
    return value
