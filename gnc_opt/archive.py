"""Results on disk: one compressed NumPy archive with a JSON header; floats keep every bit, nothing is pickled."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.errors import GncOptError


def write_archive(path: str | Path, header: Mapping[str, Any], arrays: Mapping[str, Array]) -> Path:
    """Write a header, which names its ``format`` and ``version``, and arrays; return the file written.

    ``.npz`` is appended to a path without suffix. The file is written next to the target, then replaces it: a crash
    leaves the old one.
    """
    target = Path(path)
    target = target if target.suffix else target.with_suffix(".npz")
    entries: dict[str, Any] = {"header": np.array(json.dumps(header, allow_nan=False)), **arrays}
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            np.savez_compressed(stream, **entries)
        os.chmod(name, 0o666 & ~_umask())
        os.replace(name, target)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(name)
        raise
    return target


def read_archive(path: str | Path, form: str, version: int) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return header and arrays of a file of the given format, e.g. ``"gnc_opt run"``.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    GncOptError
        The file is damaged, of another format, or of another version.
    """
    noun = form.removeprefix("gnc_opt ")
    with Path(path).open("rb") as stream:
        try:
            entries = _entries(stream)
            header = json.loads(str(entries.pop("header"))) if "header" in entries else {}
        except _NoArchive:
            raise GncOptError(f"'{path}' is not a {noun} of gnc_opt, or only part of one.") from None
        except Exception as error:  # zipfile, zlib, NumPy and JSON each have their own
            raise damaged(path, noun) from error
    if not isinstance(header, dict) or header.get("format") != form:
        raise GncOptError(f"'{path}' is an archive, but not a {noun} of gnc_opt.")
    if header.get("version") != version:
        written = f" (gnc_opt {header['written_by']})" if "written_by" in header else ""
        raise GncOptError(
            f"'{path}' has format version {header.get('version')}{written}, but this gnc_opt reads version {version}: "
            "load it with the version that wrote it."
        )
    return header, entries


def damaged(path: str | Path, noun: str) -> GncOptError:
    """Return the error for a file whose content does not make up what it says."""
    return GncOptError(f"'{path}' is damaged: its content does not make up a {noun}; save it again.")


class _NoArchive(Exception):
    """Not a zip file at all."""


def _entries(stream: BinaryIO) -> dict[str, Array]:
    """Return all arrays of an archive after looking at every checksum: NumPy may stop reading before the last byte."""
    if not zipfile.is_zipfile(stream):
        raise _NoArchive
    with zipfile.ZipFile(stream) as archive:
        broken = archive.testzip()
        if broken is not None:
            raise zipfile.BadZipFile(broken)
    stream.seek(0)
    with np.load(stream, allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
