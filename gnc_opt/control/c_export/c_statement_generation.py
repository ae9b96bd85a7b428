"""C statements of a CasADi function of scalar operations, and C literals of numbers."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError

_LITERAL = re.compile(r"(?<![\w.\[])(\d+\.\d+)(?![\w.])")
_CALL = re.compile(r"\b([a-z][a-z0-9]*)\(")


@dataclass(frozen=True)
class CFloatType:
    """Floating-point type in C: name, suffix, NumPy type; tolerances ``solved``, ``dependent``."""

    type: str
    suffix: str
    dtype: Any
    solved: float
    dependent: float

    @property
    def float_size_bytes(self) -> int:
        return int(np.dtype(self.dtype).itemsize)

    def __call__(self, value: float) -> str:
        """Return the shortest C literal that is read as the same number."""
        if np.isnan(value):
            return "NAN"
        if np.isinf(value):
            return "INFINITY" if value > 0 else "-INFINITY"
        with np.errstate(over="ignore"):
            rounded = self.dtype(value)
        if not np.isfinite(rounded):
            raise ArgumentError(f"{value:g} is beyond the numbers of the type '{self.type}': write double.")
        text = repr(float(value)) if self.dtype is np.float64 else str(rounded)
        return text + self.suffix

    def format_c_literal(self, value: float) -> str:
        """Return the C literal of a table entry; raise an error if it is not finite."""
        if not np.isfinite(value):
            raise ArgumentError(
                f"the flight code would contain the number {value!r}: a schedule must be finite."
            )
        return self(value)

    def adapt_c_expression_to_precision(self, text: str) -> str:
        """Return an expression with literals and <math.h> functions of this type."""
        if not self.suffix:
            return text
        return _CALL.sub(rf"\1{self.suffix}(", _LITERAL.sub(rf"\1{self.suffix}", text))

    def substitute_c_float_type(self, text: str) -> str:
        """Return C code with ``real_t`` replaced by the type."""
        return re.sub(r"\breal_t\b", self.type, text)

    def format_c_initializer(self, values: Array) -> str:
        """Return the initializer of an array of any dimension."""
        if np.ndim(values) == 1:
            return "{" + wrap_c_initializer_lines(self.format_c_literal(float(v)) for v in values) + "}"
        return "{" + ",\n".join(self.format_c_initializer(row) for row in values) + "}"

    def write_c_array_definition(self, name: str, values: Array) -> str:
        """Return the definition of a constant array."""
        shape = "".join(f"[{n}]" for n in np.shape(values))
        return f"static const {self.type} {name}{shape} = {self.format_c_initializer(np.asarray(values))};"


DOUBLE = CFloatType("double", "", np.float64, 1e-9, 1e-11)
FLOAT = CFloatType("float", "f", np.float32, 1e-4, 1e-5)


def wrap_c_initializer_lines(entries: Iterable[str]) -> str:
    return textwrap.fill(", ".join(entries), 110, subsequent_indent="    ", break_on_hyphens=False)


_FORMS: dict[str, str] = json.loads(Path(__file__).with_name("operations.json").read_text(encoding="utf-8"))
"""C expression of each operation. The sign of 0 is 0, that of NaN is NaN. NaN equals nothing and is not zero.
Compilers may warn of == and !=, which do not occur."""

_OPERATIONS: dict[int, str] = {getattr(ca, f"OP_{name}"): form for name, form in _FORMS.items()}
_NAMES: dict[int, str] = {getattr(ca, name): name[3:].lower() for name in dir(ca) if name.startswith("OP_")}


def write_c_statements(
    function: Any, inputs: list[str], outputs: list[str], numbers: CFloatType = DOUBLE
) -> list[str]:
    """Return the body of a C function that evaluates an SXFunction; the first input is scalar, others are pointers."""
    dense = [function.sparsity_out(k).row() for k in range(function.n_out())]
    read = _list_c_function_arguments(function, inputs)
    body, used_inputs, written = [], set(), set()
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        source, target = function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_CONST:
            body.append(f"w[{target[0]}] = {numbers(function.instruction_constant(k))};")
        elif operation == ca.OP_INPUT:
            used_inputs.add(source[0])
            body.append(f"w[{target[0]}] = {read[source[0]][source[1]]};")
        elif operation == ca.OP_OUTPUT:
            row = dense[target[0]][target[1]]
            written.add((target[0], row))
            body.append(f"{outputs[target[0]]}[{row}] = w[{source[0]}];")
        elif operation in _OPERATIONS:
            form = numbers.adapt_c_expression_to_precision(_OPERATIONS[operation]).format(
                *(f"w[{i}]" for i in source)
            )
            body.append(f"w[{target[0]}] = {form};")
        elif operation == ca.OP_CALL:
            body += _write_qp_solver_call(function, source, target, numbers)
        else:
            raise ArgumentError(
                f"operation '{_NAMES[operation]}' of function '{function.name()}' has no form in C: "
                "write the law with elementary functions."
            )
    zeros = [
        f"{outputs[k]}[{row}] = {numbers(0.0)};"
        for k in range(function.n_out())
        for row in range(function.size1_out(k))
        if (k, row) not in written
    ]
    touched = {k for k, _ in written} | {k for k in range(function.n_out()) if function.size1_out(k)}
    unused = [f"(void){inputs[k]};" for k in range(function.n_in()) if k not in used_inputs]
    unused += [f"(void){outputs[k]};" for k in range(function.n_out()) if k not in touched]
    work = [f"{numbers.type} w[{function.sz_w()}];"] if body else []
    return [*work, *unused, *body, *zeros]


def _list_c_function_arguments(function: Any, inputs: list[str]) -> list[list[str]]:
    names = []
    for k, name in enumerate(inputs):
        rows = function.sparsity_in(k).row()
        names.append([name] if k == 0 else [f"{name}[{row}]" for row in rows])
    return names


def _write_qp_solver_call(
    function: Any, source: list[int], target: list[int], numbers: CFloatType
) -> list[str]:
    """Return the C call of the QP solver: its arguments are copied to and from arrays."""
    (name,) = function.get_function()
    called = function.get_function(name)
    lines, arguments = ["{"], []
    for kind, registers, count, size in (
        ("in", source, called.n_in(), called.nnz_in),
        ("out", target, called.n_out(), called.nnz_out),
    ):
        remaining = list(registers)
        for k in range(count):
            entries, remaining = remaining[: size(k)], remaining[size(k) :]
            initialiser = f" = {{{', '.join(f'w[{i}]' for i in entries)}}}" if kind == "in" else ""
            const = "const " if kind == "in" else ""
            lines.append(f"    {const}{numbers.type} {kind}_{k}[{size(k)}]{initialiser};")
            arguments.append((f"{kind}_{k}", entries))
    lines.append(f"    {name}({', '.join(array for array, _ in arguments)});")
    for array, entries in arguments[called.n_in() :]:
        lines += [f"    w[{i}] = {array}[{j}];" for j, i in enumerate(entries) if i >= 0]
    return [*lines, "}"]
