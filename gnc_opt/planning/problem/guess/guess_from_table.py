"""Initial guess from a table of a trajectory, with one column per component."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gnc_opt.argument_checks import read_float_array, require_type
from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError, ProblemError, suggest_similar_name
from gnc_opt.model.tabular_export_and_csv_import import read_csv_columns
from gnc_opt.planning.problem.problem import Problem


def guess_from_data(
    problem: Problem, data: Mapping[str, Any] | str | Path, *, phase: str | None = None, time: str = "time"
) -> Problem:
    """Return the problem with a guess from data: columns of a DataFrame, a mapping of arrays or a CSV file.

    Parameters
    ----------
    problem : Problem
    data : mapping of str to array (n_times,), pandas.DataFrame, str or Path
        One column per component of a state or control, labelled as in reports: ``q``, ``r[0]``, ``r[1]``. Other columns
        are ignored; missing variables are guessed. A path refers to a CSV file with the labels in its first row.
    phase : str, optional
        Optional for a problem with one phase.
    time : str
        Name of the column of times, s, in ascending order.

    Returns
    -------
    Problem
        See ``Problem.with_guess``.

    Raises
    ------
    ProblemError
        No time column, no column of a state or control, missing components of a vector, or different lengths.
    ArgumentError
        The CSV file has non-numeric entries or no rows.
    FileNotFoundError
        The file does not exist.

    Examples
    --------
    >>> guessed = go.guess_from_data(problem, {"time": [0.0, 2.2], "q": [1.0, 0.0], "v": [0.0, 0.0], "a": [-1.0, 1.0]})
    >>> print(f"{go.solve(guessed, tol=1e-6).objective:.6f}")
    2.000000
    """
    require_type(
        problem, Problem, "the argument of guess_from_data()", "write guess_from_data(problem, data)"
    )
    selected = problem.get_phase(phase)
    labels = [label for variable in selected.guessable_names.values() for label in variable.labels]
    columns: Any = read_csv_columns(Path(data), [time], labels) if isinstance(data, (str, Path)) else data
    if not hasattr(columns, "keys"):
        raise ArgumentError(
            f"the data of guess_from_data() is a {type(data).__name__}: give a mapping from names to arrays, a "
            "DataFrame or the path of a CSV file."
        )
    known = [str(name) for name in columns.keys()]  # noqa: SIM118 - of a DataFrame, too
    if time not in known:
        raise ProblemError(
            f"the data of guess_from_data() has no column '{time}': {suggest_similar_name(time, known)}"
        )

    def read_data_column(name: str) -> Array:
        return read_float_array(columns[name], f"column '{name}' of the guess", ProblemError).ravel()

    times, values = read_data_column(time), {}
    for variable in selected.guessable_names.values():
        available = [label for label in variable.labels if label in known]
        if not available:
            continue
        missing = [label for label in variable.labels if label not in known]
        if missing:
            raise ProblemError(
                f"the data of guess_from_data() has a column '{available[0]}' but no '{missing[0]}': give all "
                f"components of '{variable.name}', or none."
            )
        rows = [read_data_column(label) for label in available]
        if any(row.shape != times.shape for row in rows):
            raise ProblemError(
                f"column '{available[0]}' of the guess and its times differ in length, {rows[0].size} and "
                f"{times.size}: give equal ones."
            )
        values[variable.name] = np.stack(rows)
    if not values:
        raise ProblemError(
            f"the data of guess_from_data() has no column of a state or control of {selected.label}: name them as "
            f"{', '.join(labels)}."
        )
    return problem.with_guess(selected.name, times, **values)
