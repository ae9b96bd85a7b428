"""Interpolation tables: data on a grid of one or more dimensions as expressions of a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import StrictAttributes, read_display_name, read_float_array
from gnc_opt.array_types import Array, Indices
from gnc_opt.errors import ArgumentError, ModelError, quote_value, suggest_similar_name
from gnc_opt.model.model_variables import find_declared_symbols
from gnc_opt.model.piecewise_polynomial_interpolation import METHODS, AxisPolynomials, Method
from gnc_opt.model.tabular_export_and_csv_import import read_csv_columns

Outside: TypeAlias = Literal["linear", "hold", "error"]

MAX_VALUES = 200_000
"""Largest number of values of a table; each becomes part of the expression."""


@dataclass(frozen=True, eq=False)
class TableCall:
    """Call of a table: argument column, interval comparisons and value; all SX."""

    table: Table
    arguments: Any
    comparisons: Any
    value: Any

    @cached_property
    def subexpression_hashes(self) -> frozenset[int]:
        return frozenset(node.element_hash() for node in ca.vertsplit(self.comparisons))


class Table(StrictAttributes):
    """Interpolated data on a grid, callable with expressions or numbers; created by `table`.

    Attributes
    ----------
    name : str
    grids : tuple of array
        Grid points of each axis.
    values : array (n_1, n_2, ...)
    method : {"bspline", "linear", "pchip"}
    outside : {"linear", "hold", "error"}

    Examples
    --------
    >>> thrust = go.table([0.0, 10.0, 20.0], [5.0, 6.0, 8.0], method="linear", name="thrust")
    >>> print(thrust(15.0), thrust.lower_limits, thrust.upper_limits)
    7.0 [0.] [20.]
    """

    __slots__ = ("__dict__", "grids", "method", "name", "outside", "values")

    def __init__(
        self, grids: Sequence[Array], values: Array, method: Method, outside: Outside, name: str
    ) -> None:
        self.name = name
        self.grids = tuple(grids)
        self.values = values
        self.method: Method = method
        self.outside: Outside = outside

    def __repr__(self) -> str:
        sizes = " x ".join(str(grid.size) for grid in self.grids)
        return f"Table({self.name!r}: {sizes} values, {self.method}, {self.outside} outside)"

    @property
    def lower_limits(self) -> Array:
        """Lower ends of the axes (n_axes,)."""
        return np.array([grid[0] for grid in self.grids])

    @property
    def upper_limits(self) -> Array:
        """Upper ends of the axes (n_axes,)."""
        return np.array([grid[-1] for grid in self.grids])

    def __call__(self, *arguments: Any) -> Any:
        """Return the interpolated value, one argument per axis.

        Parameters
        ----------
        *arguments : casadi.SX, float or array
            Expressions (columns are evaluated entry by entry), or numbers that broadcast against each other.

        Returns
        -------
        casadi.SX or array
            Expressions have continuous derivatives (except "linear"), also outside the table.

        Raises
        ------
        ArgumentError
            Wrong number of arguments, or numbers outside a table with ``outside="error"``.
        """
        if len(arguments) != len(self.grids):
            raise ArgumentError(
                f"table '{self.name}' has {len(self.grids)} axes but {len(arguments)} arguments: give one per axis."
            )
        if any(isinstance(a, (ca.SX, ca.MX)) for a in arguments):
            return self._build_lookup_table_expression(
                [self._read_lookup_table_argument(a) for a in arguments]
            )
        numbers = [
            read_float_array(a, f"argument {i} of table '{self.name}'") for i, a in enumerate(arguments, 1)
        ]
        if self.outside == "error":
            self._require_constants_inside_table(numbers)
        try:
            points = np.broadcast_arrays(*numbers)
        except ValueError:
            shapes = ", ".join(str(n.shape) for n in numbers)
            raise ArgumentError(
                f"the arguments of table '{self.name}' have the shapes {shapes}: give equal ones."
            ) from None
        found = (
            self._table_interpolation_function(*(p.reshape(1, -1) for p in points))
            .full()
            .reshape(points[0].shape)
        )
        return found if found.ndim else float(found)

    def _read_lookup_table_argument(self, argument: Any) -> Any:
        try:
            return ca.vec(ca.SX(argument))
        except (NotImplementedError, RuntimeError):
            raise ModelError(
                f"table '{self.name}' got {quote_value(argument)}: give SX expressions or numbers."
            ) from None

    def _require_constants_inside_table(self, numbers: Sequence[Array]) -> None:
        for i, (given, grid) in enumerate(zip(numbers, self.grids, strict=True), 1):
            beyond = given[(given < grid[0]) | (given > grid[-1])]
            if beyond.size:
                raise ArgumentError(
                    f"argument {i} of table '{self.name}' is {beyond.flat[0]:g}, outside of its range "
                    f"{grid[0]:g} to {grid[-1]:g}: use values in this range, or set outside= of the table."
                )

    def _build_lookup_table_expression(self, columns: list[Any]) -> Any:
        rows = max(column.shape[0] for column in columns)
        if any(column.shape[0] not in (1, rows) for column in columns):
            sizes = ", ".join(str(column.shape[0]) for column in columns)
            raise ModelError(
                f"the arguments of table '{self.name}' have {sizes} components: give equal sizes."
            )
        values = []
        for i in range(rows):
            point = ca.vertcat(*(column[i if column.shape[0] > 1 else 0] for column in columns))
            value, comparisons = self._interpolate_table(point)
            use = TableCall(self, point, comparisons, value)
            for symbol in find_declared_symbols(ca.symvar(point)):
                symbol.table_calls.append(use)
            values.append(value)
        return ca.vertcat(*values)

    @cached_property
    def _table_interpolation_function(self) -> Any:
        point = ca.SX.sym("point", len(self.grids))
        return ca.Function("table", ca.vertsplit(point), [self._interpolate_table(point)[0]])

    @cached_property
    def _axis_interpolation_polynomials(self) -> tuple[list[AxisPolynomials], Array]:
        axes, coefficients = [], self.values
        for k, grid in enumerate(self.grids):
            pieces, first = METHODS[self.method](grid, np.moveaxis(coefficients, k, 0))
            coefficients = np.moveaxis(first, 0, k)
            axes.append(pieces)
        if len(axes) == 1:
            own, coefficients = axes[0].convert_polynomials_to_power_basis(coefficients)
            axes = [own]
        return axes, coefficients

    def _interpolate_table(self, point: Any) -> tuple[Any, Any]:
        """Return the value at a point (n_axes, 1) and the comparisons that select its intervals, both SX."""
        axes, coefficients = self._axis_interpolation_polynomials
        found = [
            _LocatedInterval.locate_points_in_breakpoint_intervals(pieces, point[k])
            for k, pieces in enumerate(axes)
        ]
        window = ca.SX(coefficients.ravel())
        places = np.arange(coefficients.size).reshape(coefficients.shape)
        for k, (pieces, here) in enumerate(zip(axes, found, strict=True)):
            window, places = _select_polynomial_coefficients_in_cell(window, places, k, pieces, here.inside)
        for pieces, here in zip(axes, found, strict=True):  # the first axis varies slowest
            weights = here.compute_interpolation_weights(pieces, continued=self.outside != "hold")
            rest = window.numel() // weights.numel()
            window = ca.mtimes(ca.reshape(window, rest, weights.numel()), weights)
        return window, ca.vertcat(*(here.comparisons for here in found))


@dataclass(frozen=True, eq=False)
class _LocatedInterval:
    """Interval and local coordinate of a number on an axis, SX."""

    inside: Any
    u: Any
    beyond: Any
    comparisons: Any

    @classmethod
    def locate_points_in_breakpoint_intervals(cls, pieces: AxisPolynomials, x: Any) -> _LocatedInterval:
        breaks = pieces.breaks
        below, above = x < breaks[0], x > breaks[-1]
        steps = [x >= b for b in breaks[1:-1]]
        edges = ca.vertcat(1, *steps, 0)
        inside = edges[:-1] - edges[1:]
        # if_else instead of fmin and fmax, which ignore NaN
        held = ca.if_else(below, breaks[0], ca.if_else(above, breaks[-1], x))
        start, width = (ca.dot(inside, ca.SX(values)) for values in (breaks[:-1], np.diff(breaks)))
        comparisons = ca.vertcat(below, above, *steps)
        return cls(inside, (held - start) / width, (x - held) / width, comparisons)

    def compute_interpolation_weights(self, pieces: AxisPolynomials, *, continued: bool) -> Any:
        """Return the weights of the window (window, 1); outside constant or linear extrapolation."""
        n, window, powers = pieces.matrices.shape
        matrix = ca.SX(pieces.matrices[0])
        if not np.all(pieces.matrices == pieces.matrices[0]):
            flat = ca.mtimes(self.inside.T, ca.SX(pieces.matrices.reshape(n, -1)))
            matrix = ca.reshape(flat, powers, window).T
        values = [ca.SX(1)]
        slopes = [ca.SX(0)]
        for power in range(1, powers):
            slopes.append(power * values[-1])
            values.append(values[-1] * self.u)
        row = ca.vertcat(*values)
        return ca.mtimes(matrix, row + ca.vertcat(*slopes) * self.beyond if continued else row)


def _select_polynomial_coefficients_in_cell(
    window: Any, places: Indices, axis: int, pieces: AxisPolynomials, inside: Any
) -> tuple[Any, Indices]:
    """Return the window of one axis and the indices of its coefficients, from those remaining."""
    candidates = np.moveaxis(np.take(places, pieces.interval_coefficient_indices, axis=axis), axis, 0)
    n, *shape = candidates.shape
    flat = candidates.reshape(n, -1)
    chosen = ca.mtimes(inside.T, ca.reshape(window[flat.ravel(order="F").tolist()], n, flat.shape[1]))
    return chosen.T, np.arange(flat.shape[1]).reshape(shape)


def table(
    x: Any,
    values: ArrayLike | None = None,
    *,
    method: Method = "bspline",
    outside: Outside = "linear",
    name: str = "",
) -> Table:
    """Return a table: call it with expressions of a model, ``thrust(mach, altitude)``, or with numbers.

    Parameters
    ----------
    x : array (n,), sequence of arrays, or xarray.DataArray
        Grid: one increasing array, or one per axis of ``values``. A DataArray contains its values and name.
    values : array (n,) or (n_1, n_2, ...)
    method : {"bspline", "linear", "pchip"}
        Cubic spline with two continuous derivatives (recommended for optimisation); linear with kinks; cubic with one
        continuous derivative, monotone in one dimension.
    outside : {"linear", "hold", "error"}
        Linear extrapolation, constant extrapolation, or an error. Expressions with "error" extrapolate linearly,
        because iterates of a solver may leave the table.
    name : str, optional

    Raises
    ------
    ArgumentError
        A grid that is not increasing, values of a wrong shape or not finite, an unknown method.

    Examples
    --------
    >>> density = go.table([0.0, 1.0, 2.0, 3.0], [1.0, 0.5, 0.25, 0.125], method="linear")
    >>> print(float(density(0.5)))
    0.75
    """
    if hasattr(x, "dims") and hasattr(x, "coords"):  # an xarray.DataArray
        if values is not None:
            raise ArgumentError("table() got a DataArray and values: a DataArray has its own.")
        name = name or str(x.name or "")
        if bare := [str(dim) for dim in x.dims if dim not in x.coords]:
            raise ArgumentError(
                f"table() got a DataArray without coordinates along '{bare[0]}': assign them."
            )
        x, values = [np.asarray(x.coords[dim]) for dim in x.dims], np.asarray(x)
    name = read_display_name(name or "table", "table")
    if values is None:
        raise ArgumentError(f"table '{name}' got no values: write table(x, values).")
    data = read_float_array(values, f"the values of table '{name}'")
    for given, known, what in ((method, METHODS, "method"), (outside, get_args(Outside), "outside")):
        if given not in known:
            raise ArgumentError(
                f"table '{name}' has no {what} {quote_value(given)}: {suggest_similar_name(str(given), known)}"
            )
    return Table(_read_table_axes(x, data, name), data, method, outside, name)


def _read_table_axes(x: Any, data: Array, name: str) -> list[Array]:
    """Return the grid of each axis, checked against the values."""
    nested = isinstance(x, (list, tuple)) and len(x) > 0 and np.ndim(x[0]) > 0
    axes = list(x) if nested else [x]
    if len(axes) != data.ndim:
        raise ArgumentError(
            f"table '{name}' has values of the shape {data.shape} and {len(axes)} grids: give one grid per axis."
        )
    grids = [read_float_array(axis, f"grid {i} of table '{name}'") for i, axis in enumerate(axes, 1)]
    for i, (grid, size) in enumerate(zip(grids, data.shape, strict=True), 1):
        if grid.shape != (size,) or size < 2:
            raise ArgumentError(
                f"grid {i} of table '{name}' has the shape {grid.shape} and its values {data.shape}: "
                "give as many points as values along that axis, two or more."
            )
        if not np.all(np.isfinite(grid)) or not np.all(np.diff(grid) > 0):
            raise ArgumentError(
                f"grid {i} of table '{name}' does not increase: sort it and remove duplicates."
            )
    if not np.all(np.isfinite(data)):
        place = ", ".join(f"{g[i]:g}" for g, i in zip(grids, np.argwhere(~np.isfinite(data))[0], strict=True))
        raise ArgumentError(f"table '{name}' has no finite value at ({place}): fill the gap.")
    if data.size > MAX_VALUES:
        raise ArgumentError(f"table '{name}' has {data.size} values: thin it out to {MAX_VALUES} at most.")
    return grids


def table_from_csv(
    path: str | Path,
    x: str | Sequence[str],
    values: str,
    *,
    method: Method = "bspline",
    outside: Outside = "linear",
) -> Table:
    """Return a table from columns of a CSV file, named by the file's first row.

    Parameters
    ----------
    path : str or Path
    x : str or sequence of str
        Column of the grid; for several axes several columns, and one row per point of the full grid, in any order.
    values : str
        Column of the values; also the name of the table.
    method, outside
        As in `table`.

    Raises
    ------
    FileNotFoundError
        The file does not exist.
    ArgumentError
        A missing column, an entry that is not numeric, or a grid with missing or duplicate points.

    Examples
    --------
    >>> points = [[0, 5], [10, 6], [20, 8], [30, 9]]
    >>> np.savetxt("engine.csv", points, delimiter=",", header="h,thrust", comments="")
    >>> thrust = go.table_from_csv("engine.csv", "h", "thrust")
    >>> print(thrust(20.0))
    8.0
    """
    names = [x] if isinstance(x, str) else list(x)
    columns = read_csv_columns(Path(path), [*names, values])
    rows = [columns[name] for name in [*names, values]]
    axes, where = zip(*(np.unique(column, return_inverse=True) for column in rows[:-1]), strict=True)
    data = np.full([axis.size for axis in axes], np.nan)
    data[where] = rows[-1]
    if data.size != rows[0].size or np.any(np.isnan(data)):
        raise ArgumentError(
            f"the {rows[0].size} rows of {path} are not the {' x '.join(str(n) for n in data.shape)} points of a "
            f"full grid of {', '.join(names)}: give each point once."
        )
    return table(list(axes), data, method=method, outside=outside, name=values)
