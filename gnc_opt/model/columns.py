"""Columns of numbers from a CSV file."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError, did_you_mean, shown


def read_columns(path: Path, needed: Iterable[str], others: Iterable[str] = ()) -> dict[str, Array]:
    """Return columns of a CSV file by their names in its first row.

    Parameters
    ----------
    path : Path
    needed : iterable of str
    others : iterable of str
        Columns that may be missing; what is neither is not read.

    Returns
    -------
    dict of str to array (n_rows,)

    Raises
    ------
    FileNotFoundError
        There is no such file.
    ArgumentError
        A missing column, no rows, or an entry that is no number.
    """
    needed = list(needed)
    with path.open(newline="", encoding="utf-8-sig") as file:
        lines = csv.DictReader(file, skipinitialspace=True)
        known = lines.fieldnames = [name.strip() for name in lines.fieldnames or ()]
        for name in needed:
            if name not in known:
                raise ArgumentError(f"{path} has no column {shown(name)}: {did_you_mean(str(name), known)}")
        columns: dict[str, list[float]] = {name: [] for name in [*needed, *others] if name in known}
        for line in lines:
            for name, values in columns.items():
                try:
                    values.append(float(line[name]))
                except (TypeError, ValueError):
                    raise ArgumentError(
                        f"line {lines.line_num} of {path} has no number in column '{name}': correct it."
                    ) from None
    if not columns or not next(iter(columns.values())):
        raise ArgumentError(f"{path} has no rows below its first one: give the values.")
    return {name: np.array(values) for name, values in columns.items()}
