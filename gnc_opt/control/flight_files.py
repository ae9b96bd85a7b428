"""The files of flight code: header, source and driver of a law, its schedule and, if it calls one, its solver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from gnc_opt.control.c_expressions import c_statements
from gnc_opt.control.c_numbers import DOUBLE, CNumbers
from gnc_opt.control.controller import FlightLaw
from gnc_opt.control.flight_table import FlightTable
from gnc_opt.model.layout import Layout

_MOVES = (ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_ASSIGN)
"""Instructions that compute nothing."""

_NEEDS_NAN = (
    "/* A lost sample is told by comparisons, which have to be those of IEC 60559. */",
    "#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__",
    '#error "lost samples would pass: compile without -ffinite-math-only, which -ffast-math implies"',
    "#endif",
    "",
)


@dataclass(frozen=True, eq=False)
class FlightFiles:
    """A law as text.

    Attributes
    ----------
    form : FlightLaw
    start, step : casadi.Function
        Its functions as scalar operations.
    table : FlightTable
    prefix : str
        Of every C identifier.
    dt : float
        Control step, s.
    numbers : CNumbers
        Type of all but times.
    """

    form: FlightLaw
    start: Any
    step: Any
    table: FlightTable
    prefix: str
    dt: float
    numbers: CNumbers

    @property
    def operations(self) -> int:
        """Of how many operations a step consists, at most: arithmetic, comparisons, calls."""
        own = sum(self.step.instruction_id(k) not in _MOVES for k in range(self.step.n_instructions()))
        return own + self.table.operations + (0 if self.form.solver is None else self.form.solver.operations)

    @property
    def stack(self) -> int:
        """How many bytes the local arrays of the larger of both functions take, with those of its caller."""
        controller, solver = self.form.controller, self.form.solver
        row, memory = max(controller.signals.size, 1), max(controller.memory.size, 1)
        own = self.step.sz_w() + memory + (0 if solver is None else solver.stack)
        return int(self.numbers.size * (row + max(self.start.sz_w(), own)))

    def header(self, remarks: tuple[str, ...] = ()) -> str:
        """Return the header; remarks are lines of comment at its top."""
        upper, prefix, controller = self.prefix.upper(), self.prefix, self.form.controller
        bounded = "at most" if self.form.solver is not None else "the same at every step, whatever the data"
        sizes = {
            "N_STATES": controller.states.size,
            "N_COMMANDS": controller.commands.size,
            "N_SIGNALS": controller.signals.size,
            "N_MEMORY": controller.memory.size,
            "N_ROWS": len(self.table.rows),
        }
        lines = [
            f"/* {_plain(controller.name)}: discrete-time control law, written by gnc_opt. */",
            *(f"/* {_plain(remark)} */" for remark in remarks),
            f"#ifndef {upper}_H",
            f"#define {upper}_H",
            "",
            *(f"#define {upper}_{key} {value}" for key, value in sizes.items()),
            f"#define {upper}_DT {DOUBLE(self.dt)} /* control step, s */",
            f"#define {upper}_T0 {DOUBLE(self.table.first)} /* time of the first row of the schedule, s */",
            "",
            f"/* Of a step, {bounded}; no memory is allocated. */",
            f"#define {upper}_OPERATIONS {self.operations} /* arithmetic, comparisons, calls */",
            f"#define {upper}_STACK {self.stack} /* bytes of the arrays on the stack, at most */",
            f"#define {upper}_TABLE {self.table.size(self.numbers)} /* bytes of the schedule */",
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
            f"void {prefix}_signal(double t, real_t *r);",
            "/* Set the memory z from the first measurement x at t (s). */",
            f"void {prefix}_start(double t, const real_t *x, real_t *z);",
            "/* Return the command u for the control step that begins at t (s), and update the memory z. */",
            f"void {prefix}_step(double t, const real_t *x, real_t *z, real_t *u);",
            "",
            "#endif",
            "",
        ]
        return self.numbers.typed("\n".join(lines))

    def source(self) -> str:
        """Return the law and its tables."""
        upper, prefix, controller = self.prefix.upper(), self.prefix, self.form.controller
        signals, memory = controller.signals.size, controller.memory.size
        time = "t" if self.numbers is DOUBLE else "(real_t)t"
        lines = [
            f'#include "{prefix}.h"',
            "",
            "#include <math.h>",
            "",
            *_NEEDS_NAN,
            *self.table.text(self.numbers),
        ]
        if self.form.solver is not None:
            lines += [
                "static const real_t *row_of(long k)",
                "{",
                f"    return schedule[k < {upper}_N_ROWS ? k : {upper}_N_ROWS - 1];",
                "}",
                "",
                self.form.solver.text(self.numbers),
            ]
        lines += self._function("start", ["t", "x", "r"], ["z"], self.start)
        lines += self._function("step", ["t", "x", "r", "z"], ["u", "z_next"], self.step)
        lines += [f"void {prefix}_signal(double t, real_t *r)", "{"]
        if signals:
            lines += [
                f"    const double place = floor((t - {upper}_T0) / {upper}_DT + 1e-6);",
                "    long row = 0;",
                "    /* written so that a time which is not a number takes the first row */",
                f"    if (place >= {upper}_N_ROWS - 1)",
                f"        row = {upper}_N_ROWS - 1;",
                "    else if (place > 0)",
                "        row = (long)place;",
                "    look_up(row, r);",
            ]
        else:
            lines += ["    (void)t;", "    (void)r;"]
        lines += [
            "}",
            "",
            f"void {prefix}_start(double t, const real_t *x, real_t *z)",
            "{",
            f"    real_t r[{max(signals, 1)}];",
            f"    {prefix}_signal(t, r);",
            f"    start({time}, x, r, z);",
            "}",
            "",
            f"void {prefix}_step(double t, const real_t *x, real_t *z, real_t *u)",
            "{",
            f"    real_t r[{max(signals, 1)}];",
            f"    real_t z_next[{max(memory, 1)}];",
        ]
        if memory:
            lines.append("    int i;")
        lines += [f"    {prefix}_signal(t, r);", f"    step({time}, x, r, z, u, z_next);"]
        if memory:
            lines += [f"    for (i = 0; i < {upper}_N_MEMORY; ++i)", "        z[i] = z_next[i];"]
        return self.numbers.typed("\n".join([*lines, "}", ""]))

    def driver(self) -> str:
        """Return a program that reads measurements and writes commands."""
        upper = self.prefix.upper()
        form = "%lf" if self.numbers is DOUBLE else "%f"
        lines = [
            "/* Test driver: reads lines of a time and a state, writes the commands of successive steps.",
            " * With an argument it runs a built-in case instead: three steps with all states at 0.1. */",
            "#include <stdio.h>",
            "",
            f'#include "{self.prefix}.h"',
            "",
            "static int read_line(double *t, real_t *x)",
            "{",
            "    int i;",
            '    if (scanf("%lf", t) != 1)',
            "        return 0;",
            f"    for (i = 0; i < {upper}_N_STATES; ++i)",
            f'        if (scanf("{form}", &x[i]) != 1)',
            "            return 0;",
            "    return 1;",
            "}",
            "",
            "static void run(double t, const real_t *x, real_t *z, int *begun)",
            "{",
            f"    real_t u[{upper}_N_COMMANDS];",
            "    int i;",
            "    if (!*begun)",
            f"        {self.prefix}_start(t, x, z);",
            "    *begun = 1;",
            f"    {self.prefix}_step(t, x, z, u);",
            f"    for (i = 0; i < {upper}_N_COMMANDS; ++i)",
            f'        printf("%.17g%s", (double)u[i], i + 1 < {upper}_N_COMMANDS ? " " : "\\n");',
            "}",
            "",
            "int main(int argc, char **argv)",
            "{",
            f"    real_t x[{upper}_N_STATES];",
            f"    real_t z[{max(self.form.controller.memory.size, 1)}] = {{{self.numbers(0.0)}}};",
            f"    double t = {upper}_T0;",
            "    int begun = 0, k;",
            "    (void)argv;",
            "    if (argc > 1) {",
            f"        for (k = 0; k < {upper}_N_STATES; ++k)",
            f"            x[k] = {self.numbers(0.1)};",
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
        return self.numbers.typed("\n".join(lines))

    # --- internals ----------------------------------------------------------------------------------------

    def _function(self, name: str, inputs: list[str], outputs: list[str], function: Any) -> list[str]:
        arguments = [f"real_t {inputs[0]}", *(f"const real_t *{i}" for i in inputs[1:])]
        arguments += [f"real_t *{o}" for o in outputs]
        body = c_statements(function, inputs, outputs, self.numbers)
        return [
            f"static void {name}({', '.join(arguments)})",
            "{",
            *(f"    {line}" for line in body),
            "}",
            "",
        ]


def _entries(layout: Layout) -> list[str]:
    pairs = zip(layout.labels, layout.units, strict=True)
    return [_plain(f"[{i}] {label}, {unit or '-'}") for i, (label, unit) in enumerate(pairs)]


def _plain(text: str) -> str:
    """Text that can stand in a comment of any compiler."""
    return text.encode("ascii", "replace").decode().replace("*/", "* /").replace("/*", "/ *")
