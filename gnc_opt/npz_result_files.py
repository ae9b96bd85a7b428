"""Result files: compressed NumPy archives with a JSON header, without pickle; floats are stored exactly.

The header is a tree of JSON values with type tags. The arrays are named by their path in the tree
(``phases.leg.lam_start``). Only registered classes are created.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import IO, Any, BinaryIO, TypeAlias

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.errors import GncOptError

Arrays: TypeAlias = dict[str, Array]


@dataclass(frozen=True)
class DataclassSerializer:
    """Conversion of ``classes`` (dataclasses, enumerations) to JSON trees, without their ``left_out`` fields."""

    classes: tuple[type, ...]
    left_out: Mapping[type, tuple[str, ...]] = field(default_factory=dict)

    def list_saved_dataclass_fields(self, kind: Any) -> list[str]:
        return [f.name for f in fields(kind) if f.init and f.name not in self.left_out.get(kind, ())]

    def serialise_to_json_tree(self, value: Any, place: str, arrays: Arrays) -> Any:
        """Return the JSON tree of a value, and store its arrays in ``arrays`` under their path in the tree.

        Mappings are restored as dicts, lists as tuples, NumPy scalars as Python scalars.

        Raises
        ------
        GncOptError
            An object has an unregistered class; the message contains its path.
        """
        if isinstance(value, np.ndarray):
            return {"array": _store_array_under_json_path(value, place, arrays)}
        if isinstance(value, Enum):
            return {"type": self._get_storable_class_name(value, place), "value": value.value}
        if is_dataclass(value):
            members = {
                name: self.serialise_to_json_tree(
                    getattr(value, name), _append_name_to_json_path(place, name), arrays
                )
                for name in self.list_saved_dataclass_fields(type(value))
            }
            return {"type": self._get_storable_class_name(value, place), "fields": members}
        if isinstance(value, Mapping):
            if not all(isinstance(key, str) for key in value):
                raise GncOptError(f"'{place}' cannot be saved: its keys are not all names.")
            return {
                "map": {
                    key: self.serialise_to_json_tree(item, _append_name_to_json_path(place, key), arrays)
                    for key, item in value.items()
                }
            }
        if isinstance(value, (tuple, list)):
            return self._serialise_sequence_to_json(value, place, arrays)
        if isinstance(value, (float, np.floating)):
            return float(value) if math.isfinite(value) else {"float": repr(float(value))}
        return _convert_to_json_value(value.item() if isinstance(value, np.generic) else value, place)

    def restore_result_from_json_tree(self, tree: Any, arrays: Mapping[str, Array]) -> Any:
        if isinstance(tree, list):
            return tuple(self.restore_result_from_json_tree(item, arrays) for item in tree)
        if not isinstance(tree, dict):
            return tree
        if "array" in tree:
            array = arrays[tree["array"]]
            array.setflags(write=False)
            return array
        if "pieces" in tree:
            return tuple(np.split(arrays[tree["pieces"]], np.cumsum(tree["sizes"])[:-1], axis=-1))
        if "alike" in tree:
            different = [self.restore_result_from_json_tree(item, arrays) for item in tree["alike"]]
            return tuple(different[i] for i in arrays[tree["which"]])
        if "float" in tree:
            return float(tree["float"])
        if "map" in tree:
            return {
                key: self.restore_result_from_json_tree(item, arrays) for key, item in tree["map"].items()
            }
        kind: Any = {c.__name__: c for c in self.classes}[tree["type"]]
        if "value" in tree:
            return kind(tree["value"])
        return kind(
            **{key: self.restore_result_from_json_tree(item, arrays) for key, item in tree["fields"].items()}
        )

    def _serialise_sequence_to_json(
        self, value: tuple[Any, ...] | list[Any], place: str, arrays: Arrays
    ) -> Any:
        if _can_concatenate_arrays(value):
            whole = _store_array_under_json_path(np.concatenate(value, axis=-1), place, arrays)
            return {"pieces": whole, "sizes": [item.shape[-1] for item in value]}
        trees = [
            self.serialise_to_json_tree(item, _append_name_to_json_path(place, str(i)), arrays)
            for i, item in enumerate(value)
        ]
        if not all(is_dataclass(item) for item in value):
            return trees
        texts = [json.dumps(tree) for tree in trees]
        numbers = {text: i for i, text in enumerate(dict.fromkeys(texts))}
        if len(numbers) == len(trees):
            return trees
        which = _store_array_under_json_path(np.array([numbers[text] for text in texts]), place, arrays)
        return {"alike": [json.loads(text) for text in numbers], "which": which}

    def _get_storable_class_name(self, value: Any, place: str) -> str:
        if type(value) not in self.classes:
            raise _build_unstorable_type_error(value, place)
        return type(value).__name__


def _can_concatenate_arrays(value: tuple[Any, ...] | list[Any]) -> bool:
    if not value or not all(isinstance(item, np.ndarray) and item.ndim for item in value):
        return False
    return len({(item.dtype, item.shape[:-1]) for item in value}) == 1


def _store_array_under_json_path(array: Array, place: str, arrays: Arrays) -> str:
    if array.dtype.hasobject:
        raise GncOptError(f"'{place}' cannot be saved: it is an array of Python objects.")
    name = "".join(c if c.isprintable() and c not in '/\\:*?"<>|' else "_" for c in place)
    while name in arrays:
        name += "_"
    arrays[name] = array
    return name


def _convert_to_json_value(value: Any, place: str) -> Any:
    if value is None or isinstance(value, (str, bool, int)):
        return value
    raise _build_unstorable_type_error(value, place)


def _build_unstorable_type_error(value: Any, place: str) -> GncOptError:
    return GncOptError(f"'{place}' cannot be saved: files cannot store a {type(value).__name__}.")


def _append_name_to_json_path(place: str, name: str) -> str:
    return f"{place}.{name}" if place else name


@dataclass(frozen=True)
class FileFormat:
    """File format of results of one class, the ``kind``.

    Raise ``version`` if a stored class changes its fields; ``alike`` are compatible older versions, and ``unused`` the
    values in their files that are not read.
    """

    kind: type
    noun: str
    version: int
    packing: DataclassSerializer
    alike: tuple[int, ...] = ()
    unused: tuple[str, ...] = ()

    def write_result_file(
        self, path: str | Path, result: Any, *, written_by: str | None = None, **more: Any
    ) -> Path:
        """Write a result and additional named values; return the path of the file.

        ``.npz`` is appended to a path without suffix. The file is replaced atomically.

        Raises
        ------
        OSError
            The file cannot be written, e.g. because its folder does not exist.
        GncOptError
            The result contains an object that cannot be stored.
        """
        arrays: Arrays = {}
        header: dict[str, Any] = {"format": self._npz_format_identifier, "version": self.version}
        if written_by is not None:
            header["written_by"] = written_by
        header[self.noun] = self.packing.serialise_to_json_tree(result, "", arrays)
        header |= {
            name: self.packing.serialise_to_json_tree(value, name, arrays) for name, value in more.items()
        }
        return _write_npz_archive(path, header, arrays)

    def read_result_file(self, path: str | Path) -> tuple[Any, dict[str, Any]]:
        """Return the result in a file, and the additional values.

        Raises
        ------
        FileNotFoundError
            The file does not exist.
        GncOptError
            The file is damaged, or has another format or version.
        """
        header, arrays = _read_npz_archive(path, self.noun)
        if not isinstance(header, dict) or header.get("format") != self._npz_format_identifier:
            raise GncOptError(f"'{path}' is an archive, but not a {self.noun} of gnc_opt.")
        version = header.get("version")
        if version not in (self.version, *self.alike):
            written = f" (gnc_opt {header['written_by']})" if "written_by" in header else ""
            raise GncOptError(
                f"'{path}' has format version {version}{written}, but this gnc_opt reads version {self.version}: "
                "load it with the version that wrote it."
            )
        try:
            trees = {
                name: tree for name, tree in header.items() if name not in (*_ABOUT_THE_FILE, *self.unused)
            }
            values = {
                name: self.packing.restore_result_from_json_tree(tree, arrays) for name, tree in trees.items()
            }
            result = values.pop(self.noun)
        except Exception as error:  # any error: the tree does not describe a result
            raise _build_damaged_archive_error(path, self.noun) from error
        if not isinstance(result, self.kind):
            raise _build_damaged_archive_error(path, self.noun)
        return result, values

    @property
    def _npz_format_identifier(self) -> str:
        return f"gnc_opt {self.noun}"


_ABOUT_THE_FILE = ("format", "version", "written_by")


def _write_npz_archive(path: str | Path, header: Mapping[str, Any], arrays: Mapping[str, Array]) -> Path:
    target = Path(path)
    target = target if target.suffix else target.with_suffix(".npz")
    entries: dict[str, Any] = {"header": np.array(json.dumps(header, allow_nan=False)), **arrays}
    with open_for_atomic_write(target) as stream:
        np.savez_compressed(stream, **entries)
    return target


@contextlib.contextmanager
def open_for_atomic_write(target: Path) -> Iterator[IO[bytes]]:
    """Open a temporary file that replaces the target after a complete write and is deleted otherwise."""
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            yield stream
        os.chmod(name, 0o666 & ~_read_file_umask())
        os.replace(name, target)
    except BaseException as error:
        with contextlib.suppress(OSError):
            os.unlink(name)
        if isinstance(error, OSError) and error.errno is not None and error.filename is None:
            error.filename = str(target)  # the error of a full disk lacks the path
        raise


def _read_npz_archive(path: str | Path, noun: str) -> tuple[Any, Arrays]:
    with Path(path).open("rb") as stream:
        try:
            entries = _read_checksum_verified_arrays(stream)
            header = json.loads(str(entries.pop("header"))) if "header" in entries else {}
        except _NotAnArchive:
            raise GncOptError(f"'{path}' is not a {noun} of gnc_opt, or only part of one.") from None
        except Exception as error:  # zipfile, zlib, NumPy and JSON raise different errors
            raise _build_damaged_archive_error(path, noun) from error
    return header, entries


def _build_damaged_archive_error(path: str | Path, noun: str) -> GncOptError:
    return GncOptError(f"'{path}' is damaged: its content is not a complete {noun}; save it again.")


class _NotAnArchive(Exception):
    """The file is not a zip archive."""


def _read_checksum_verified_arrays(stream: BinaryIO) -> dict[str, Array]:
    """Return all arrays of an archive after verifying their checksums, which NumPy does not do completely."""
    if not zipfile.is_zipfile(stream):
        raise _NotAnArchive
    with zipfile.ZipFile(stream) as archive:
        broken = archive.testzip()
        if broken is not None:
            raise zipfile.BadZipFile(broken)
    stream.seek(0)
    with np.load(stream, allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}


def _read_file_umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
