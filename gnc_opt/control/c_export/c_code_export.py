"""Export of a controller as self-contained C99, with its schedule, a header and a test driver.

Files: ``<name>.h`` (sizes, indices, names, units), ``<name>.c`` (law), ``<name>_main.c`` (test driver).
The code allocates no memory. No loop depends on data, except the bounded iterations of `design_mpc`.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_float_array, read_variable_name, require_type, suggest_keywords
from gnc_opt.array_types import Array
from gnc_opt.control.c_export.c_statement_generation import DOUBLE, FLOAT, CFloatType, write_c_statements
from gnc_opt.control.c_export.c_table_of_references_and_gains import (
    CScheduleTable,
    tabulate_references_and_gains,
)
from gnc_opt.control.discrete_time_controller import CodegenLaw, Controller
from gnc_opt.errors import ArgumentError, GncOptError, quote_value, suggest_similar_name
from gnc_opt.model.model_variables import Layout

_NUMBERS = {"float64": DOUBLE, "float32": FLOAT}


@dataclass(frozen=True)
class CCode:
    """Files and properties of the exported C code.

    Attributes
    ----------
    header, source, driver : Path
    name : str
        Prefix of every C identifier.
    rows : int
        Number of rows of the schedule table.
    dt : float
        Control step, s.
    table_bytes : int
    command_error : array (n_commands,) or None
        Largest differences between the commands of the compiled code and of the law, over the given samples.

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
    command_error: Array | None = None


@suggest_keywords
def export_c(
    controller: Controller,
    directory: str | Path,
    *,
    dt: float | None = None,
    name: str | None = None,
    span: tuple[float, float] | None = None,
    precision: Literal["float64", "float32"] = "float64",
    samples: tuple[ArrayLike, ArrayLike] | None = None,
) -> CCode:
    """Return the files of a controller, exported as C99 code.

    ``<name>_start(t, x, z)`` sets the memory from the first measurement. ``<name>_step(t, x, z, u)`` computes the
    command and updates the memory. Both use the schedule row of the control step that contains t (s).

    Parameters
    ----------
    controller : Controller
        From a design function or `output_feedback`.
    directory : path
        Output directory; created if missing.
    dt : float, optional
        Control step, s; default: the controller's own.
    name : str, optional
        Prefix of the C identifiers; default: the controller's name in lower case.
    span : (initial_time, final_time), optional
        Times between which the schedule changes; required if the controller does not define them.
    precision : {"float64", "float32"}
        Type of all numbers except times, which are double.
    samples : (times (n,), measured (n_states, n)), optional
        Consecutive control steps, e.g. ``(run.times[:-1], run.measured)``, on which compiled code and law are compared.

    Raises
    ------
    ArgumentError
        The law contains operations without a C equivalent, the schedule changes after the span, dt or the span is
        unknown, or the samples have wrong shapes.
    GncOptError
        Samples are given and the C compiler is missing or fails.

    Examples
    --------
    >>> code = go.export_c(go.design_lqr(cart, [0, 0], Q=1, R=1, dt=0.1), "flight")
    >>> print(sorted(path.suffix for path in Path("flight").iterdir())[:2])
    ['.c', '.c']
    """
    require_type(controller, Controller, "the argument of export_c()", "give the result of a design function")
    dt = controller.step_length(dt)
    prefix = _read_c_identifier_prefix(_make_c_identifier(controller.name) if name is None else name)
    form = select_codegen_controller(controller)
    if form.solver is not None and span is not None:
        raise ArgumentError(f"'{controller.name}' knows the span of its schedule: omit span.")
    if precision not in _NUMBERS:
        raise ArgumentError(
            f"there is no precision {quote_value(precision)}: {suggest_similar_name(str(precision), list(_NUMBERS))}"
        )
    step, start = (
        _expand_law_to_scalar_function(f, form) for f in (form.controller.step, form.controller.start)
    )
    table = tabulate_references_and_gains(form.controller, dt, span)
    files = CSourceFiles(form, start, step, table, prefix, dt, _NUMBERS[precision])
    folder = Path(directory)
    folder.mkdir(parents=True, exist_ok=True)
    header, source, driver = (folder / f"{prefix}{end}" for end in (".h", ".c", "_main.c"))
    header.write_text(files.write_c_header(), encoding="ascii")
    source.write_text(files.write_c_source(), encoding="ascii")
    driver.write_text(files.write_test_driver(), encoding="ascii")
    size = table.count_schedule_table_bytes(files.numbers)
    code = CCode(header, source, driver, prefix, len(table.rows), dt, size)
    if samples is None:
        return code
    errors = measure_generated_code_error(controller, source, driver, samples, dt)
    header.write_text(
        files.write_c_header(_format_generated_code_mismatch(np.size(samples[0]), errors)), encoding="ascii"
    )
    return replace(code, command_error=errors)


def _format_generated_code_mismatch(count: int, errors: Array) -> str:
    by = ", ".join(f"{v:.2g}" for v in errors)
    return f"compared with the law in double precision over {count} samples: commands differ by at most {by}"


def _read_c_identifier_prefix(name: str) -> str:
    prefix = read_variable_name(name, "C function")
    if not prefix.isascii():
        raise ArgumentError(
            f"'{prefix}' cannot be the name of flight code: use letters of C, A to Z and a to z."
        )
    return prefix


def select_codegen_controller(controller: Controller) -> CodegenLaw:
    """Return the controller for C export: the same, or its `CodegenLaw` if it solves a problem at every step."""
    return CodegenLaw(controller) if controller.codegen_law is None else controller.codegen_law


def _expand_law_to_scalar_function(function: Any, form: CodegenLaw) -> Any:
    what = f"the law of '{form.controller.name}' is not made of elementary operations (it calls another function)"
    remedy = "write it with functions of its own symbols, or take a law of a design function."
    try:
        scalar = function if function.is_a("SXFunction") else function.expand()
    except RuntimeError as error:
        raise ArgumentError(f"{what}: {remedy}") from error
    calls = any(scalar.instruction_id(k) == ca.OP_CALL for k in range(scalar.n_instructions()))
    if calls and form.solver is None:
        raise ArgumentError(f"{what}: {remedy}")
    return scalar


def _make_c_identifier(name: str) -> str:
    text = "".join(c.lower() if c.isascii() and c.isalnum() else "_" for c in name).strip("_")
    return f"law_{text}" if not text or text[0].isdigit() else text


_FLAGS = ("-std=c99", "-O1", "-ffp-contract=off")


def measure_generated_code_error(
    controller: Controller, source: Path, driver: Path, samples: tuple[ArrayLike, ArrayLike], dt: float
) -> Array:
    """Return the largest differences (n_commands,) between commands of the compiled code and of the law."""
    times, measured = _read_generated_code_test_samples(controller, samples)
    compiler = shutil.which("cc")
    if compiler is None:
        raise GncOptError(
            "no C compiler (cc) is found to compare flight code with its law: install one, or leave samples out."
        )
    expected, z = np.empty((controller.commands.size, times.size)), None
    for k, t in enumerate(times):
        expected[:, k], z = controller(t, measured[:, k], z, dt)
    with tempfile.TemporaryDirectory() as folder:
        program = str(Path(folder, "driver"))
        command = [compiler, *_FLAGS, "-o", program, str(source), str(driver), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise GncOptError(f"{compiler} could not compile the flight code: {done.stderr.strip()[:500]}")
        lines = [" ".join(repr(float(v)) for v in (t, *x)) for t, x in zip(times, measured.T, strict=True)]
        call = subprocess.run([program], input="\n".join(lines), capture_output=True, text=True, check=True)
    commands = np.array([[float(v) for v in line.split()] for line in call.stdout.splitlines()]).T
    return np.asarray(np.max(np.abs(commands - expected), axis=1))


def _read_generated_code_test_samples(
    controller: Controller, samples: tuple[ArrayLike, ArrayLike]
) -> tuple[Array, Array]:
    remedy = "give (times (n,), measured (n_states, n)), for example (run.times[:-1], run.measured)"
    if not isinstance(samples, tuple) or len(samples) != 2:
        raise ArgumentError(f"the samples of export_c() are no pair: {remedy}.")
    times, measured = (read_float_array(s, "the samples of export_c()", ArgumentError) for s in samples)
    if times.ndim != 1 or times.size == 0 or measured.shape != (controller.states.size, times.size):
        raise ArgumentError(
            f"the samples of export_c() have the shapes {times.shape} and {measured.shape}, and "
            f"'{controller.name}' measures {controller.states.size} states: {remedy}."
        )
    return times, measured


_MOVES = (ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_ASSIGN)
"""CasADi instructions without a result."""

_NEEDS_NAN = (
    "/* Comparisons detect lost samples and must follow IEC 60559. */",
    "#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__",
    '#error "lost samples would pass: compile without -ffinite-math-only, which -ffast-math implies"',
    "#endif",
    "",
)


@dataclass(frozen=True, eq=False)
class CSourceFiles:
    """Law as text: start and step as scalar operations, identifier prefix, step (s), number type."""

    form: CodegenLaw
    start: Any
    step: Any
    table: CScheduleTable
    prefix: str
    dt: float
    numbers: CFloatType

    @property
    def max_operation_count(self) -> int:
        """Largest number of operations of a step: arithmetic, comparisons, calls."""
        step_count = sum(self.step.instruction_id(k) not in _MOVES for k in range(self.step.n_instructions()))
        return step_count + (0 if self.form.solver is None else self.form.solver.max_operation_count)

    @property
    def stack_size_bytes(self) -> int:
        """Return the bytes of the local arrays of the larger function and of its caller."""
        controller, solver = self.form.controller, self.form.solver
        row, memory = max(controller.signals.size, 1), max(controller.memory.size, 1)
        step_floats = self.step.sz_w() + memory + (0 if solver is None else solver.max_stack_float_count)
        return int(self.numbers.float_size_bytes * (row + max(self.start.sz_w(), step_floats)))

    def write_c_header(self, remark: str = "") -> str:
        """Return the C header; ``remark`` is a comment at its top."""
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
            f"/* {_escape_c_comment(controller.name)}: discrete-time control law, written by gnc_opt. */",
            *([f"/* {_escape_c_comment(remark)} */"] if remark else []),
            f"#ifndef {upper}_H",
            f"#define {upper}_H",
            "",
            *(f"#define {upper}_{key} {value}" for key, value in sizes.items()),
            f"#define {upper}_DT {DOUBLE(self.dt)} /* control step, s */",
            f"#define {upper}_T0 {DOUBLE(self.table.first)} /* time of the first row of the schedule, s */",
            "",
            f"/* Of a step, {bounded}; no memory is allocated. */",
            f"#define {upper}_OPERATIONS {self.max_operation_count} /* arithmetic, comparisons, calls */",
            f"#define {upper}_STACK {self.stack_size_bytes} /* bytes of the arrays on the stack, at most */",
            f"#define {upper}_TABLE {self.table.count_schedule_table_bytes(self.numbers)} /* bytes of the schedule */",
            "",
            "/* Contents of the arrays, with units:",
        ]
        parts = {
            "x (states, measured)": controller.states,
            "u (commands)": controller.commands,
            "r (schedule)": controller.signals,
            "z (memory)": controller.memory,
        }
        for title, layout in parts.items():
            lines.append(f" * {title}: {layout.size}")
            lines += [f" *   {entry}" for entry in _write_c_comments_of_signals(layout)]
        if controller.alarms:
            lines.append(f" * alarms (not 0: guarantees lost): {', '.join(controller.alarms)}, entries of z")
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
        return self.numbers.substitute_c_float_type("\n".join(lines))

    def write_c_source(self) -> str:
        upper, prefix = self.prefix.upper(), self.prefix
        lines = [
            f'#include "{prefix}.h"',
            "",
            "#include <math.h>",
            "",
            *_NEEDS_NAN,
            *self.table.write_schedule_table_code(self.numbers),
        ]
        if self.form.solver is not None:
            lines += [
                "static const real_t *row_of(long k)",
                "{",
                f"    return schedule[k < {upper}_N_ROWS ? k : {upper}_N_ROWS - 1];",
                "}",
                "",
                self.form.solver.write_qp_solver_code(self.numbers),
            ]
        lines += self._write_c_function("start", ["t", "x", "r"], ["z"], self.start)
        lines += self._write_c_function("step", ["t", "x", "r", "z"], ["u", "z_next"], self.step)
        return self.numbers.substitute_c_float_type(
            "\n".join([*lines, self._fill_c_file_template("interface.c")])
        )

    def write_test_driver(self) -> str:
        """Return the C source of a program that reads measurements and writes commands."""
        return self.numbers.substitute_c_float_type(self._fill_c_file_template("driver.c"))

    def _fill_c_file_template(self, name: str) -> str:
        double, controller = self.numbers is DOUBLE, self.form.controller
        values = {
            "prefix": self.prefix,
            "upper": self.prefix.upper(),
            "signals": max(controller.signals.size, 1),
            "memory": max(controller.memory.size, 1),
            "time": "t" if double else "(real_t)t",
            "format": "%lf" if double else "%f",
            "zero": self.numbers(0.0),
            "tenth": self.numbers(0.1),
        }
        text = Path(__file__).with_name(name).read_text(encoding="ascii")
        return re.sub(r"@(\w+)@", lambda found: str(values[found[1]]), text)

    def _write_c_function(self, name: str, inputs: list[str], outputs: list[str], function: Any) -> list[str]:
        arguments = [f"real_t {inputs[0]}", *(f"const real_t *{i}" for i in inputs[1:])]
        arguments += [f"real_t *{o}" for o in outputs]
        body = write_c_statements(function, inputs, outputs, self.numbers)
        return [
            f"static void {name}({', '.join(arguments)})",
            "{",
            *(f"    {line}" for line in body),
            "}",
            "",
        ]


def _write_c_comments_of_signals(layout: Layout) -> list[str]:
    pairs = zip(layout.labels, layout.units, strict=True)
    return [_escape_c_comment(f"[{i}] {label}, {unit or '-'}") for i, (label, unit) in enumerate(pairs)]


def _escape_c_comment(text: str) -> str:
    return text.encode("ascii", "replace").decode().replace("*/", "* /").replace("/*", "/ *")
