"""Flight code: a controller as self-contained C99, with its schedule, a header that names everything and a driver.

Three files: ``<name>.h`` (sizes, indices, names, units), ``<name>.c`` (the law and the schedule's table) and
``<name>_main.c`` (a driver for tests). No library beside the C mathematics is needed, and no memory is allocated. The
order of operations is that of the symbolic law, so results agree to rounding, and no loop depends on data; but for the
quadratic programme of `design_mpc`, which is solved by a method of its own with a bounded number of iterations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import expect, read_name, read_positive
from gnc_opt.arrays import Array
from gnc_opt.control.c_numbers import DOUBLE, FLOAT
from gnc_opt.control.controller import Controller, FlightLaw
from gnc_opt.control.flight_comparison import command_error
from gnc_opt.control.flight_files import FlightFiles
from gnc_opt.control.flight_table import flight_table
from gnc_opt.errors import ArgumentError, did_you_mean, shown

_NUMBERS = {"float64": DOUBLE, "float32": FLOAT}
_C_HEADERS = frozenset({
    "assert", "complex", "ctype", "errno", "fenv", "float", "inttypes", "iso646",
    "limits", "locale", "math", "setjmp", "signal", "stdarg", "stdbool",
    "stddef", "stdint", "stdio", "stdlib", "string", "tgmath", "time", "wchar", "wctype",
})  # fmt: skip
"""Standard headers of C99, without suffix (ISO/IEC 9899:1999, 7.1.2)."""


@dataclass(frozen=True)
class FlightCode:
    """Where the code was written.

    Attributes
    ----------
    header, source, driver : Path
    name : str
        Prefix of every C identifier.
    rows : int
        Of the schedule's table.
    dt : float
        Control step, s.
    table_bytes : int
        Of the schedule.
    table_error : float
        Of the schedule between its knots, relative to the largest number of each column; 0 if every row is kept.
    command_error : array (n_commands,) or None
        Largest difference of the compiled code's commands from the law's over the given samples.

    Examples
    --------
    >>> code = go.export_c(regulator, "flight")
    >>> print(code.header.name, code.source.name, code.rows, code.dt)
    lqr.h lqr.c 1 0.1
    """

    header: Path
    source: Path
    driver: Path
    name: str
    rows: int
    dt: float
    table_bytes: int
    table_error: float
    command_error: Array | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class CodeOptions:
    """How flight code is made smaller, and what it is then compared on.

    Attributes
    ----------
    precision : {"float64", "float32"}
        Of all numbers but times, which stay double: a clock in single precision would lose the row of the schedule.
    table_tolerance : float
        Largest error of interpolated gains, relative to the largest of each; 0: no interpolation. References and
        feedforwards are kept row by row.
    samples : (times (n,), measured (n_states, n)), optional
        A flight, of one control step after the other: ``(run.times[:-1], run.measured)``. The code is compiled
        (``cc``) and run over it, and what its commands miss the law's by is told.

    Examples
    --------
    >>> from gnc_opt.control import CodeOptions
    >>> code = go.export_c(regulator, "small", options=CodeOptions(precision="float32"))
    >>> print(code.table_bytes)
    12
    """

    precision: Literal["float64", "float32"] = "float64"
    table_tolerance: float = 0.0
    samples: tuple[ArrayLike, ArrayLike] | None = None


def export_c(
    controller: Controller,
    directory: str | Path,
    *,
    dt: float | None = None,
    name: str | None = None,
    span: tuple[float, float] | None = None,
    options: CodeOptions | None = None,
) -> FlightCode:
    """Write a controller as C99 into a directory.

    ``<name>_start(t, x, z)`` sets the memory from the first measurement, ``<name>_step(t, x, z, u)`` returns the
    command and updates the memory. The row of the schedule is that of the control step that t (s) lies in: rows at
    multiples of dt from the beginning of the controller's span; after the last row, that row.

    Parameters
    ----------
    controller : Controller
        What a design function or `output_feedback` returned.
    directory : path
        Made if it is not there.
    dt : float, optional
        Control step, s; by default the controller's own.
    name : str, optional
        Prefix of the C identifiers, by default the controller's name in small letters.
    span : (initial_time, final_time), optional
        Times between which the schedule changes, if the controller does not tell.
    options : CodeOptions, optional
        Single precision, interpolated gains, and a flight over which the code is compared with the law.

    Returns
    -------
    FlightCode
        Where the files are, and what they hold.

    Raises
    ------
    ArgumentError
        The law holds operations that have no C, the schedule still changes after the span, nobody knows dt or
        the span, or the files would be called like a header of C; options that do not fit.
    GncOptError
        Samples, and no C compiler, or it failed.

    Examples
    --------
    >>> code = go.export_c(go.design_lqr(cart, [0, 0], Q=1, R=1, dt=0.1), "flight")
    >>> print(sorted(path.suffix for path in Path("flight").iterdir())[:2])
    ['.c', '.c']
    """
    expect(controller, Controller, "what export_c() got", "give what a design function returned")
    dt = controller.step_length(dt)
    prefix = _read_prefix(_identifier(controller.name) if name is None else name)
    form = flight_form(controller)
    if form.solver is not None and span is not None:
        raise ArgumentError(f"'{controller.name}' knows the span of its schedule: leave it out.")
    told = _read_options(options, form)
    step, start = (_elementary(f, form) for f in (form.controller.step, form.controller.start))
    table = flight_table(form.controller, dt, span, float(told.table_tolerance))
    files = FlightFiles(form, start, step, table, prefix, dt, _NUMBERS[told.precision])
    folder = Path(directory)
    folder.mkdir(parents=True, exist_ok=True)
    header, source, driver = (folder / f"{prefix}{end}" for end in (".h", ".c", "_main.c"))
    header.write_text(files.header(), encoding="ascii")
    source.write_text(files.source(), encoding="ascii")
    driver.write_text(files.driver(), encoding="ascii")
    size = table.size(files.numbers)
    code = FlightCode(header, source, driver, prefix, len(table.rows), dt, size, table.error)
    if told.samples is None:
        return code
    missed = command_error(controller, source, driver, told.samples, dt)
    header.write_text(files.header(_remarks(code, told, missed)), encoding="ascii")
    return replace(code, command_error=missed)


def _read_options(options: CodeOptions | None, form: FlightLaw) -> CodeOptions:
    told = CodeOptions() if options is None else options
    expect(told, CodeOptions, "the options of export_c()", "give CodeOptions(...)")
    if told.precision not in _NUMBERS:
        raise ArgumentError(
            f"there is no precision {shown(told.precision)}: {did_you_mean(str(told.precision), list(_NUMBERS))}"
        )
    tolerance = read_positive(told.table_tolerance, "the table tolerance of export_c()", or_zero=True)
    if tolerance >= 1:
        raise ArgumentError(f"the table tolerance of export_c() is {tolerance:g}: give a share below 1.")
    if tolerance and form.solver is not None:
        raise ArgumentError(
            f"the schedule of '{form.controller.name}' has no gains to interpolate: leave table_tolerance out."
        )
    return told


def _remarks(code: FlightCode, options: CodeOptions, missed: Array) -> tuple[str, ...]:
    """What the options cost, for the header."""
    count = np.size(options.samples[0]) if options.samples is not None else 0
    by = ", ".join(f"{v:.2g}" for v in missed)
    told = [
        f"compared with the law in double precision over {count} samples: commands differ by at most {by}"
    ]
    if options.table_tolerance:
        told.append(f"interpolated gains: off by at most {code.table_error:.2g} of the largest of each")
    return tuple(told)


def _read_prefix(name: str) -> str:
    prefix = read_name(name, "C function")
    if not prefix.isascii():
        raise ArgumentError(
            f"'{prefix}' cannot be the name of flight code: use letters of C, A to Z and a to z."
        )
    if prefix.lower() in _C_HEADERS:  # file systems may not tell capitals apart
        raise ArgumentError(
            f"'{prefix}' cannot be the name of flight code: its files would hide the header '{prefix.lower()}.h' of C; "
            f"give export_c(..., name='{prefix}_law')."
        )
    return prefix


def flight_form(controller: Controller) -> FlightLaw:
    """Return the controller as flight code has it: itself, unless it solves a problem at every step."""
    return FlightLaw(controller) if controller.flight is None else controller.flight


def _elementary(function: Any, form: FlightLaw) -> Any:
    """The function as scalar operations."""
    what = f"the law of '{form.controller.name}' is not made of elementary operations (it calls another function)"
    remedy = "write it with functions of its own symbols, or take a law of a design function."
    try:
        scalar = function if function.is_a("SXFunction") else function.expand()
    except RuntimeError as error:
        raise ArgumentError(f"{what}: {remedy}") from error
    # CasADi may keep a solver as one call among scalar operations
    calls = any(scalar.instruction_id(k) == ca.OP_CALL for k in range(scalar.n_instructions()))
    if calls and form.solver is None:
        raise ArgumentError(f"{what}: {remedy}")
    return scalar


def _identifier(name: str) -> str:
    text = "".join(c.lower() if c.isascii() and c.isalnum() else "_" for c in name).strip("_")
    return f"law_{text}" if not text or text[0].isdigit() else text
