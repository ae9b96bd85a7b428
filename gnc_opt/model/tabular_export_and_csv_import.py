"""Export of quantities along one axis to other packages and files, and import of CSV columns."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError, quote_value, suggest_similar_name
from gnc_opt.model.model_variables import Layout, Variable
from gnc_opt.text_html_and_json_formatting import format_json
from gnc_opt.threads_and_package_versions import import_optional_package


def read_csv_columns(path: Path, needed: Iterable[str], others: Iterable[str] = ()) -> dict[str, Array]:
    """Return columns (n_rows,) of a CSV file by their names in its first row; those in ``others`` are optional.

    Raises
    ------
    FileNotFoundError
        The file does not exist.
    ArgumentError
        A missing column, no rows, or an entry that is not numeric.
    """
    needed = list(needed)
    with path.open(newline="", encoding="utf-8-sig") as file:
        lines = csv.DictReader(file, skipinitialspace=True)
        known = lines.fieldnames = [name.strip() for name in lines.fieldnames or ()]
        for name in needed:
            if name not in known:
                raise ArgumentError(
                    f"{path} has no column {quote_value(name)}: {suggest_similar_name(str(name), known)}"
                )
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


@dataclass(frozen=True)
class TabularData:
    """Quantities with a value at each point of an axis: times, or indices of runs.

    Attributes
    ----------
    axis : Variable
        Name and unit of the axis.
    points : array (n,)
    quantities : tuple of (Variable, array (size, n))
        Values: numbers, or strings such as an outcome.
    about : mapping
        Attributes of the data set.
    """

    axis: Variable
    points: Any
    quantities: tuple[tuple[Variable, Any], ...]
    about: Mapping[str, Any]

    @property
    def columns(self) -> dict[str, Any]:
        """Each component (n,) by its label."""
        return {
            label: row
            for variable, values in self.quantities
            for label, row in zip(variable.labels, values, strict=True)
        }

    @property
    def units(self) -> dict[str, str]:
        of = {label: variable.unit for variable, _ in self.quantities for label in variable.labels}
        return {self.axis.name: self.axis.unit, **of}

    def to_pandas(self) -> Any:
        """Return a DataFrame with one column per component; units and attributes are in ``attrs``."""
        pandas = import_optional_package("pandas", "data")
        frame = pandas.DataFrame(self.columns, index=pandas.Index(self.points, name=self.axis.name))
        frame.attrs = {**self.about, "units": self.units}
        return frame

    def to_xarray(self) -> Any:
        """Return a Dataset with units; vectors have a dimension for their components."""
        xarray = import_optional_package("xarray", "data")
        axis = self.axis.name
        variables = {}
        for variable, values in self.quantities:
            scalar = variable.size == 1
            dimensions = (axis,) if scalar else (f"{variable.name}_component", axis)
            variables[variable.name] = (dimensions, values[0] if scalar else values, {"units": variable.unit})
        return xarray.Dataset(variables, {axis: (axis, self.points, {"units": self.axis.unit})}, self.about)

    def write(self, path: str | Path) -> Path:
        """Write a file in the format of its suffix and return its path; raise `ArgumentError` for other suffixes.

        ``.csv``: one column per component. ``.json``: with units and attributes. ``.mat``: matrices (n, size).
        """
        target = Path(path)
        if target.suffix not in _WRITERS:
            known = ", ".join(_WRITERS)
            raise ArgumentError(f"'{target}' cannot be exported: its suffix must be one of {known}.")
        _WRITERS[target.suffix](self, target)
        return target


def iterate_nan_padded_variables(
    layout: Layout, values: Array, prefix: str = "", length: int | None = None
) -> Iterator[tuple[Variable, Array]]:
    missing = np.full((layout.size, (length or values.shape[1]) - values.shape[1]), np.nan)
    whole = np.hstack([values, missing])
    for variable in layout.variables:
        yield replace(variable, name=f"{prefix}{variable.name}"), whole[layout.slice(variable.name)]


def _write_csv_file(records: TabularData, path: Path) -> None:
    rows = zip(records.points, *records.columns.values(), strict=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([records.axis.name, *records.columns])
        writer.writerows(map(_format_csv_value, row) for row in rows)


def _write_json_file(records: TabularData, path: Path) -> None:
    content = {
        **records.about,
        "units": records.units,
        records.axis.name: records.points,
        "columns": records.columns,
    }
    path.write_text(format_json(content, indent=None), encoding="utf-8")


def _write_matlab_file(records: TabularData, path: Path) -> None:
    content: dict[str, Any] = {
        _format_matlab_identifier(records.axis.name): np.asarray(records.points)[:, None]
    }
    units = {_format_matlab_identifier(records.axis.name): records.axis.unit}
    for variable, values in records.quantities:
        name = _format_matlab_identifier(variable.name)
        content[name] = (
            np.array(list(values[0]), dtype=object)[:, None]
            if np.asarray(values).dtype.kind in "OU"
            else np.asarray(values).T
        )
        units[name] = variable.unit
    scipy.io.savemat(path, {**content, "units": units}, long_field_names=True)


_WRITERS: dict[str, Callable[[TabularData, Path], None]] = {
    ".csv": _write_csv_file,
    ".json": _write_json_file,
    ".mat": _write_matlab_file,
}


def _format_csv_value(value: Any) -> Any:
    plain = value.item() if isinstance(value, np.generic) else value
    return "" if isinstance(plain, float) and not np.isfinite(plain) else plain


def _format_matlab_identifier(name: str) -> str:
    return "".join(c if c.isalnum() else "_" for c in name).rstrip("_")
