"""Log: signals of a run as they come, in memory or in files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gnc_opt.arrays import Array


class Log:
    """Arrays (size, n_times) that are filled column by column; unused columns are removed at the end.

    Parameters
    ----------
    shapes : mapping of str to (int, int)
    folder : path, optional
        Made if it is not there; each array is ``<name>.npy`` in it, and none is kept in memory.
    """

    def __init__(self, shapes: Mapping[str, tuple[int, int]], folder: str | Path | None = None) -> None:
        self._filled = dict.fromkeys(shapes, 0)
        self.arrays: dict[str, Array] = {}
        if folder is not None:
            Path(folder).mkdir(parents=True, exist_ok=True)
        for name, shape in shapes.items():
            in_memory = folder is None or 0 in shape  # an empty file cannot be mapped
            self.arrays[name] = (
                np.empty(shape) if in_memory else _mapped(Path(str(folder), f"{name}.npy"), shape)
            )

    def add(self, name: str, columns: Any) -> None:
        """Append columns (size, n)."""
        columns = np.asarray(columns, dtype=float)
        begin = self._filled[name]
        self._filled[name] = begin + columns.shape[1]
        self.arrays[name][:, begin : begin + columns.shape[1]] = columns

    def close(self) -> dict[str, Array]:
        """Return the arrays; those in files are read as they are needed."""
        return {name: array[:, : self._filled[name]] for name, array in self.arrays.items()}


def _mapped(path: Path, shape: tuple[int, int]) -> Array:
    return np.lib.format.open_memmap(path, mode="w+", dtype=np.float64, shape=shape, fortran_order=True)
