"""Flight code: a controller as self-contained C99, with its schedule, a header that names everything and a driver.

Three files: ``<name>.h`` (sizes, indices, names, units), ``<name>.c`` (the law and the schedule's table) and
``<name>_main.c`` (a driver for tests). No library beside the C mathematics is needed, and no memory is allocated. The
order of operations is that of the symbolic law, so results agree to rounding, and no loop depends on data; but for the
quadratic programme of `design_mpc`, which is solved by a method of its own with a bounded number of iterations.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arguments import expect, read_name
from gnc_opt.arrays import Array
from gnc_opt.control.c_expressions import c_statements
from gnc_opt.control.c_numbers import DOUBLE
from gnc_opt.control.controller import Controller, FlightLaw
from gnc_opt.errors import ArgumentError
from gnc_opt.model.layout import Layout

_TAIL_TOLERANCE = 1e-12
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


def export_c(
    controller: Controller,
    directory: str | Path,
    *,
    dt: float | None = None,
    name: str | None = None,
    span: tuple[float, float] | None = None,
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

    Returns
    -------
    FlightCode
        Where the files are, and what they hold.

    Raises
    ------
    ArgumentError
        The law holds operations that have no C, the schedule still changes after the span, nobody knows dt or
        the span, or the files would be called like a header of C.

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
    step, start = (_elementary(f, form) for f in (form.controller.step, form.controller.start))
    first, table = _table(form.controller, dt, span)
    folder = Path(directory)
    folder.mkdir(parents=True, exist_ok=True)
    files = {
        f"{prefix}.h": _header(form, prefix, dt, first, table.shape[0], (start, step)),
        f"{prefix}.c": _source(form, prefix, table, step, start),
        f"{prefix}_main.c": _driver(form.controller, prefix),
    }
    for file, text in files.items():
        (folder / file).write_text(text, encoding="ascii")
    paths = [folder / file for file in files]
    return FlightCode(paths[0], paths[1], paths[2], prefix, table.shape[0], dt)


def _read_prefix(name: str) -> str:
    prefix = read_name(name, "C function")
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


def _table(controller: Controller, dt: float, span: tuple[float, float] | None) -> tuple[float, Array]:
    """The time of the first row and the rows (n_rows, n_signals), the last of them good for ever."""
    if controller.signals.size == 0:
        return 0.0, np.zeros((1, 0))
    found = controller.span if span is None else span
    if found is None:
        raise ArgumentError(
            f"the schedule of '{controller.name}' does not tell when it ends: give export_c(..., span=(t_0, t_f))."
        )
    first, last = (float(t) for t in found)
    if not (np.isfinite(first) and np.isfinite(last) and first <= last):
        raise ArgumentError(f"the span of a schedule is {found}: give finite times (t_0, t_f), t_0 <= t_f.")
    # rounding: a row at the end itself is of the tail; a little before it is not
    count = int(np.ceil((last - first) / dt - 1e-9)) + 1
    times = first + dt * np.append(np.arange(count + 1), count + 1000)
    rows = controller.schedule(times, dt).T
    change = np.max(np.abs(rows[count:] - rows[count - 1]), initial=0.0)
    if change > _TAIL_TOLERANCE * max(np.max(np.abs(rows[count - 1]), initial=0.0), 1.0):
        raise ArgumentError(
            f"the schedule of '{controller.name}' still changes by {change:.3g} after {last:g} s: "
            "give a span that holds all its changes."
        )
    return first, rows[:count]


def _header(
    form: FlightLaw, prefix: str, dt: float, first: float, rows: int, functions: tuple[Any, Any]
) -> str:
    upper, controller = prefix.upper(), form.controller
    bounded = "at most" if form.solver is not None else "the same at every step, whatever the data"
    sizes = {
        "N_STATES": controller.states.size,
        "N_COMMANDS": controller.commands.size,
        "N_SIGNALS": controller.signals.size,
        "N_MEMORY": controller.memory.size,
        "N_ROWS": rows,
    }
    lines = [
        f"/* {_plain(controller.name)}: discrete-time control law, written by gnc_opt. */",
        f"#ifndef {upper}_H",
        f"#define {upper}_H",
        "",
        *(f"#define {upper}_{key} {value}" for key, value in sizes.items()),
        f"#define {upper}_DT {DOUBLE(dt)} /* control step, s */",
        f"#define {upper}_T0 {DOUBLE(first)} /* time of the first row of the schedule, s */",
        "",
        f"/* Of a step, {bounded}; no memory is allocated. */",
        f"#define {upper}_OPERATIONS {operations(form, functions[1])} /* arithmetic, comparisons, calls */",
        f"#define {upper}_STACK {stack_bytes(form, *functions)} /* bytes of the arrays on the stack, at most */",
        "",
        "/* What the arrays hold, with units:",
    ]
    parts = {
        "x (states, measured)": controller.states,
        "u (commands)": controller.commands,
        "r (schedule)": controller.signals,
        "z (memory)": controller.memory,
    }
    for title, layout in parts.items():
        lines.append(f" * {title}: {layout.size}")
        lines += [f" *   {entry}" for entry in _entries(layout)]
    if controller.alarms:
        lines.append(f" * alarms (not 0: the law gave up): {', '.join(controller.alarms)}, entries of z")
    lines += [
        " */",
        "",
        "/* Arrays of no entries may be passed as null pointers. */",
        "/* Look up the row r of the schedule for the control step that t (s) lies in. */",
        f"void {prefix}_signal(double t, double *r);",
        "/* Set the memory z from the first measurement x at t (s). */",
        f"void {prefix}_start(double t, const double *x, double *z);",
        "/* Return the command u for the control step that begins at t (s), and update the memory z. */",
        f"void {prefix}_step(double t, const double *x, double *z, double *u);",
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def _source(form: FlightLaw, prefix: str, table: Array, step: Any, start: Any) -> str:
    upper, controller, numbers = prefix.upper(), form.controller, DOUBLE
    signals, memory = controller.signals.size, controller.memory.size
    lines = [f'#include "{prefix}.h"', "", "#include <math.h>", ""]
    if signals:
        lines += [
            f"static const double schedule[{upper}_N_ROWS][{upper}_N_SIGNALS] = {numbers.nested(table)};",
            "",
        ]
    if form.solver is not None:
        lines += [
            "static const double *row_of(long k)",
            "{",
            f"    return schedule[k < {upper}_N_ROWS ? k : {upper}_N_ROWS - 1];",
            "}",
            "",
            form.solver.text(numbers),
        ]
    lines += _function("start", ["t", "x", "r"], ["z"], start)
    lines += _function("step", ["t", "x", "r", "z"], ["u", "z_next"], step)
    lines += [f"void {prefix}_signal(double t, double *r)", "{"]
    if signals:
        lines += [
            f"    const double place = floor((t - {upper}_T0) / {upper}_DT + 1e-6);",
            "    long row = 0;",
            "    int i;",
            "    /* written so that a time which is not a number takes the first row */",
            f"    if (place >= {upper}_N_ROWS - 1)",
            f"        row = {upper}_N_ROWS - 1;",
            "    else if (place > 0)",
            "        row = (long)place;",
            f"    for (i = 0; i < {upper}_N_SIGNALS; ++i)",
            "        r[i] = schedule[row][i];",
        ]
    else:
        lines += ["    (void)t;", "    (void)r;"]
    lines += [
        "}",
        "",
        f"void {prefix}_start(double t, const double *x, double *z)",
        "{",
        f"    double r[{max(signals, 1)}];",
        f"    {prefix}_signal(t, r);",
        "    start(t, x, r, z);",
        "}",
        "",
        f"void {prefix}_step(double t, const double *x, double *z, double *u)",
        "{",
        f"    double r[{max(signals, 1)}];",
        f"    double z_next[{max(memory, 1)}];",
    ]
    if memory:
        lines.append("    int i;")
    lines += [f"    {prefix}_signal(t, r);", "    step(t, x, r, z, u, z_next);"]
    if memory:
        lines += [f"    for (i = 0; i < {upper}_N_MEMORY; ++i)", "        z[i] = z_next[i];"]
    return "\n".join([*lines, "}", ""])


def _function(name: str, inputs: list[str], outputs: list[str], function: Any) -> list[str]:
    arguments = [f"double {inputs[0]}", *(f"const double *{i}" for i in inputs[1:])]
    arguments += [f"double *{o}" for o in outputs]
    return [
        f"static void {name}({', '.join(arguments)})",
        "{",
        *(f"    {line}" for line in c_statements(function, inputs, outputs)),
        "}",
        "",
    ]


def _driver(controller: Controller, prefix: str) -> str:
    upper = prefix.upper()
    memory = max(controller.memory.size, 1)
    return "\n".join(
        [
            "/* Test driver: reads lines of a time and a state, writes the commands of successive steps.",
            " * With an argument it runs a built-in case instead: three steps with all states at 0.1. */",
            "#include <stdio.h>",
            "",
            f'#include "{prefix}.h"',
            "",
            "static int read_line(double *t, double *x)",
            "{",
            "    int i;",
            '    if (scanf("%lf", t) != 1)',
            "        return 0;",
            f"    for (i = 0; i < {upper}_N_STATES; ++i)",
            '        if (scanf("%lf", &x[i]) != 1)',
            "            return 0;",
            "    return 1;",
            "}",
            "",
            "static void run(double t, const double *x, double *z, int *begun)",
            "{",
            f"    double u[{upper}_N_COMMANDS];",
            "    int i;",
            "    if (!*begun)",
            f"        {prefix}_start(t, x, z);",
            "    *begun = 1;",
            f"    {prefix}_step(t, x, z, u);",
            f"    for (i = 0; i < {upper}_N_COMMANDS; ++i)",
            f'        printf("%.17g%s", u[i], i + 1 < {upper}_N_COMMANDS ? " " : "\\n");',
            "}",
            "",
            "int main(int argc, char **argv)",
            "{",
            f"    double x[{upper}_N_STATES];",
            f"    double z[{memory}] = {{0.0}};",
            f"    double t = {upper}_T0;",
            "    int begun = 0, k;",
            "    (void)argv;",
            "    if (argc > 1) {",
            f"        for (k = 0; k < {upper}_N_STATES; ++k)",
            "            x[k] = 0.1;",
            "        for (k = 0; k < 3; ++k)",
            f"            run({upper}_T0 + k * {upper}_DT, x, z, &begun);",
            "        return 0;",
            "    }",
            "    while (read_line(&t, x))",
            "        run(t, x, z, &begun);",
            "    return 0;",
            "}",
            "",
        ]
    )


_MOVES = (ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_ASSIGN)
"""Instructions that compute nothing."""


def operations(form: FlightLaw, step: Any) -> int:
    """Return of how many operations a step consists, at most: arithmetic, comparisons, calls."""
    own = sum(step.instruction_id(k) not in _MOVES for k in range(step.n_instructions()))
    return own + (0 if form.solver is None else form.solver.operations)


def stack_bytes(form: FlightLaw, start: Any, step: Any) -> int:
    """Return how many bytes the local arrays of the larger of two functions take, with those of its caller."""
    row, memory = max(form.controller.signals.size, 1), max(form.controller.memory.size, 1)
    solver = 0 if form.solver is None else form.solver.stack
    return int(DOUBLE.size * (row + max(start.sz_w(), step.sz_w() + memory + solver)))


def _entries(layout: Layout) -> list[str]:
    pairs = zip(layout.labels, layout.units, strict=True)
    return [_plain(f"[{i}] {label}, {unit or '-'}") for i, (label, unit) in enumerate(pairs)]


def _identifier(name: str) -> str:
    text = "".join(c.lower() if c.isascii() and c.isalnum() else "_" for c in name).strip("_")
    return f"law_{text}" if not text or text[0].isdigit() else text


def _plain(text: str) -> str:
    """Text that can stand in a comment of any compiler."""
    return text.encode("ascii", "replace").decode().replace("*/", "* /").replace("/*", "/ *")
