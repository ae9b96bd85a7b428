"""Packing: frozen dataclasses as a tree of JSON values and named arrays, and back; floats keep every bit.

The tree is tagged with the types of its members. Arrays are named by their place in it (``phases.leg.lam_start``).
Only the classes that are listed are written, and no others are ever made: unpacking runs nobody else's code.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from enum import Enum
from typing import Any, TypeAlias

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.errors import GncOptError

Arrays: TypeAlias = dict[str, Array]


@dataclass(frozen=True)
class Packing:
    """Packs and unpacks instances of some classes.

    Attributes
    ----------
    classes : tuple of types
        Dataclasses and enumerations that may occur.
    left_out : mapping of type to names
        Fields that are not packed; they have defaults.
    """

    classes: tuple[type, ...]
    left_out: Mapping[type, tuple[str, ...]] = field(default_factory=dict)

    def stored_fields(self, kind: Any) -> list[str]:
        """Return the names of the fields of a dataclass that are packed."""
        return [f.name for f in fields(kind) if f.init and f.name not in self.left_out.get(kind, ())]

    def pack(self, value: Any, place: str, arrays: Arrays) -> Any:
        """Return the JSON tree of a value; its arrays go to ``arrays`` under their place in the tree.

        Mappings come back as dicts, lists as tuples, NumPy's scalars as Python's.

        Raises
        ------
        GncOptError
            Something in it is of a class that is not listed; the message names the place.
        """
        if isinstance(value, np.ndarray):
            return {"array": _put(value, place, arrays)}
        if isinstance(value, Enum):
            return {"type": self._name(value, place), "value": value.value}
        if is_dataclass(value):
            members = {
                name: self.pack(getattr(value, name), _join(place, name), arrays)
                for name in self.stored_fields(type(value))
            }
            return {"type": self._name(value, place), "fields": members}
        if isinstance(value, Mapping):
            if not all(isinstance(key, str) for key in value):
                raise GncOptError(f"'{place}' cannot be saved: its keys are not all names.")
            return {"map": {key: self.pack(item, _join(place, key), arrays) for key, item in value.items()}}
        if isinstance(value, (tuple, list)):
            return self._pack_sequence(value, place, arrays)
        if isinstance(value, (float, np.floating)):
            return float(value) if math.isfinite(value) else {"float": repr(float(value))}
        return _plain(value.item() if isinstance(value, np.generic) else value, place)

    def unpack(self, tree: Any, arrays: Mapping[str, Array]) -> Any:
        """Return the value of a tree that `pack` made."""
        if isinstance(tree, list):
            return tuple(self.unpack(item, arrays) for item in tree)
        if not isinstance(tree, dict):
            return tree
        if "array" in tree:
            array = arrays[tree["array"]]
            array.setflags(write=False)
            return array
        if "pieces" in tree:
            return tuple(np.split(arrays[tree["pieces"]], np.cumsum(tree["sizes"])[:-1], axis=-1))
        if "alike" in tree:
            different = [self.unpack(item, arrays) for item in tree["alike"]]
            return tuple(different[i] for i in arrays[tree["which"]])
        if "float" in tree:
            return float(tree["float"])
        if "map" in tree:
            return {key: self.unpack(item, arrays) for key, item in tree["map"].items()}
        kind: Any = {c.__name__: c for c in self.classes}[tree["type"]]
        if "value" in tree:
            return kind(tree["value"])
        return kind(**{key: self.unpack(item, arrays) for key, item in tree["fields"].items()})

    # --- internals ----------------------------------------------------------------------------------------

    def _pack_sequence(self, value: tuple[Any, ...] | list[Any], place: str, arrays: Arrays) -> Any:
        if _pieces(value):
            # one entry for all segments of a polynomial: thousands of tiny entries would be slow and big
            whole = _put(np.concatenate(value, axis=-1), place, arrays)
            return {"pieces": whole, "sizes": [item.shape[-1] for item in value]}
        trees = [self.pack(item, _join(place, str(i)), arrays) for i, item in enumerate(value)]
        if not all(is_dataclass(item) for item in value):
            return trees
        texts = [json.dumps(tree) for tree in trees]
        numbers = {text: i for i, text in enumerate(dict.fromkeys(texts))}
        if len(numbers) == len(trees):
            return trees
        # the outcomes of a campaign: thousands, and few of them differ
        which = _put(np.array([numbers[text] for text in texts]), place, arrays)
        return {"alike": [json.loads(text) for text in numbers], "which": which}

    def _name(self, value: Any, place: str) -> str:
        if type(value) not in self.classes:
            raise _unknown(value, place)
        return type(value).__name__


def _pieces(value: tuple[Any, ...] | list[Any]) -> bool:
    """Whether these are arrays that can lie side by side."""
    if not value or not all(isinstance(item, np.ndarray) and item.ndim for item in value):
        return False
    return len({(item.dtype, item.shape[:-1]) for item in value}) == 1


def _put(array: Array, place: str, arrays: Arrays) -> str:
    """Store an array; return the name it got, which is a safe name of a file."""
    if array.dtype.hasobject:
        raise GncOptError(f"'{place}' cannot be saved: it is an array of Python objects.")
    name = "".join(c if c.isprintable() and c not in '/\\:*?"<>|' else "_" for c in place)
    while name in arrays:
        name += "_"
    arrays[name] = array
    return name


def _plain(value: Any, place: str) -> Any:
    if value is None or isinstance(value, (str, bool, int)):
        return value
    raise _unknown(value, place)


def _unknown(value: Any, place: str) -> GncOptError:
    return GncOptError(f"'{place}' cannot be saved: files do not hold a {type(value).__name__}.")


def _join(place: str, name: str) -> str:
    return f"{place}.{name}" if place else name
