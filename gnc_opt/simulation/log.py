"""Log: signals of a run as they come, in memory or in files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from gnc_opt.arrays import Array

_HEADER = 192
"""Bytes of the header of a file."""


class Log:
    """Arrays (size, n_times) that are filled column by column; unused columns are removed at the end.

    Parameters
    ----------
    shapes : mapping of str to (int, int)
    folder : path, optional
        Made if it is not there; each array goes to ``<name>.npy`` in it as it comes, and none is kept in memory.

    Attributes
    ----------
    arrays : dict
        In memory, or empty ones that stand for files.
    """

    def __init__(self, shapes: Mapping[str, tuple[int, int]], folder: str | Path | None = None) -> None:
        self._folder = None if folder is None else Path(folder)
        self._filled = dict.fromkeys(shapes, 0)
        self._files: dict[str, BinaryIO] = {}
        self.arrays: dict[str, Array] = {}
        if self._folder is not None:
            self._folder.mkdir(parents=True, exist_ok=True)
        for name, shape in shapes.items():
            self.arrays[name] = np.empty(shape if self._folder is None else (shape[0], 0))
            if self._folder is not None:
                self._files[name] = file = (self._folder / f"{name}.npy").open("wb")
                _write_header(file, shape)

    def add(self, name: str, columns: Any) -> None:
        """Append columns (size, n)."""
        columns = np.asarray(columns, dtype=float)
        begin = self._filled[name]
        self._filled[name] = begin + columns.shape[1]
        if self._folder is not None:
            self._files[name].write(columns.astype("<f8").tobytes(order="F"))
            return
        self.arrays[name][:, begin : begin + columns.shape[1]] = columns

    def close(self) -> dict[str, Array]:
        """Return the arrays; those in files are read as they are needed."""
        if self._folder is None:
            return {name: array[:, : self._filled[name]] for name, array in self.arrays.items()}
        for name, file in self._files.items():
            _write_header(file, (self.arrays[name].shape[0], self._filled[name]))
            file.close()
        return {name: self._read(self._folder / f"{name}.npy") for name in self.arrays}

    def _read(self, path: Path) -> Array:
        with path.open("rb") as file:
            np.lib.format.read_magic(file)
            shape, _, _ = np.lib.format.read_array_header_1_0(file)
        # an empty file cannot be mapped
        return np.asarray(np.load(path, mmap_mode="r" if 0 not in shape else None))


def _write_header(file: BinaryIO, shape: tuple[int, int]) -> None:
    """Write the header of an array, columns one after the other: they are written as they come.

    Its length does not depend on the shape, which is known only when the run has ended.
    """
    content = f"{{'descr': '<f8', 'fortran_order': True, 'shape': {shape}}}"
    file.seek(0)
    file.write(np.lib.format.magic(1, 0) + (_HEADER - 10).to_bytes(2, "little"))
    file.write(content.ljust(_HEADER - 11).encode("latin1") + b"\n")
