"""Flagship problems of one phase as documents of the problem set's format, which every program can read.

States, controls, times, integrals and the objective are divided by their magnitudes: most programs do not scale. The
guess of the problem is sampled. Expressions become sums, products and functions of numbered intermediate values.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from benchmarks.validation import engine
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.guess.initial_guess import build_phase_guess

FRACTIONS = np.linspace(0.0, 1.0, 61)
"""Where the guess is sampled."""
LEAST_MAGNITUDE = 1e-6

OPERATIONS = {
    ca.OP_ASSIGN: "{}", ca.OP_ADD: "{} + {}", ca.OP_SUB: "{} - {}", ca.OP_MUL: "{} * {}", ca.OP_DIV: "{} / {}",
    ca.OP_NEG: "-{}", ca.OP_SQ: "{} ** 2", ca.OP_TWICE: "2 * {}", ca.OP_INV: "1 / {}", ca.OP_POW: "{} ** {}",
    ca.OP_CONSTPOW: "{} ** {}", ca.OP_SQRT: "sqrt({})", ca.OP_SIN: "sin({})", ca.OP_COS: "cos({})",
    ca.OP_TAN: "tan({})", ca.OP_EXP: "exp({})", ca.OP_LOG: "log({})", ca.OP_TANH: "tanh({})",
}  # fmt: skip
"""Operations that all programs know."""


def documents(groups: Sequence[str], names: Sequence[str] = ()) -> Iterator[dict[str, Any]]:
    """Yield the documents of the one-phase problems of some groups of `engine` that all programs can state."""
    for case in engine.cases(groups, names, Path()):
        problem, reference = engine.stated(case)
        if len(problem.phases) == 1 and reference is not None and not case.variant:
            try:
                yield _Scaled(problem, reference.value).document(case.name, reference.tolerance)
            except KeyError as operation:
                print(f"{case.name}: left out, operation {operation} is not known to all programs")


class _Scaled:
    """A problem of one phase in variables without units."""

    def __init__(self, problem: go.Problem, reference: float) -> None:
        self.problem, self.phase = problem, next(iter(problem.phases.values()))
        self.guess = build_phase_guess(self.phase, FRACTIONS, perturbed=False)
        numbers, (initial, final) = self.phase.numbers, self.phase.time_ranges()
        self.time = _magnitude(self.guess.times, initial, final).max()
        boxes = (numbers.states, numbers.initial, numbers.final)
        self.states = _magnitude(self.guess.states, *boxes)
        self.controls = _magnitude(self.guess.controls, numbers.controls)
        self.parameters = _magnitude(problem.get_parameter_guess()[:, None], problem.get_parameter_bounds())
        self.objective = abs(reference) or 1.0
        self.reference = reference

    def document(self, name: str, tolerance: float) -> dict[str, Any]:
        """Return the document; `reference` is 1 or -1 unless it is zero."""
        problem, numbers, (initial, final) = self.problem, self.phase.numbers, self.phase.time_ranges()
        names = [[f"{kind}{i}" for i in range(size)] for kind, size in self._sizes().items()]
        states, controls, free = names
        along, aux = self._along(["t", *states, *controls, *free])
        n, n_paths = len(states), self.phase.path_expression().numel()
        integrals = {f"J{i}": text for i, text in enumerate(along[n + n_paths :])}
        ends, _ = self._ends(
            [*(f"{x}_i1" for x in states), *(f"{x}_f1" for x in states), "t_i1", "t_f1",
             *(f"{integral}_1" for integral in integrals), *free]
        )  # fmt: skip
        phase = {
            "t0": _pair(initial, self.time)[0], "tf": _pair(final, self.time)[0],
            "tguess": (self.guess.times / self.time).tolist(),
            "states": [
                {"name": x, "x0": first, "xf": last, "lb": low, "ub": high, "guess": guess}
                for x, first, last, (low, high), guess in zip(
                    states, _pair(numbers.initial, self.states), _pair(numbers.final, self.states),
                    _pair(numbers.states, self.states), _lines(self.guess.states, self.states), strict=True,
                )
            ],
            "controls": [
                {"name": u, "lb": low, "ub": high, "guess": guess}
                for u, (low, high), guess in zip(
                    controls, _pair(numbers.controls, self.controls),
                    _lines(self.guess.controls, self.controls), strict=True,
                )
            ],
            "aux": aux, "ode": dict(zip(states, along[:n], strict=True)), "integrals": integrals,
            "path": _limited(along[n : n + n_paths], self.phase.get_path_bounds()),
        }  # fmt: skip
        events = _limited(ends[1:-1], problem.get_boundary_constraint_bounds())
        span = _pair(numbers.duration, self.time)[0]
        if span != [0.0, None]:
            events.append({"expr": ends[-1], "lb": span[0], "ub": span[1]})
        parameters = [
            {"name": p, "lb": low, "ub": high, "guess": guess}
            for p, (low, high), guess in zip(
                free, _pair(problem.get_parameter_bounds(), self.parameters),
                problem.get_parameter_guess() / self.parameters, strict=True,
            )
        ]  # fmt: skip
        return {
            "name": name, "sense": "min" if problem.sense > 0 else "max", "constants": {}, "parameters": parameters,
            "phases": [phase], "events": events, "objective": ends[0],
            "reference": self.reference / self.objective, "reference_uncertainty": tolerance / self.objective,
        }  # fmt: skip

    def _sizes(self) -> dict[str, int]:
        return {"x": self.states.size, "u": self.controls.size, "p": self.parameters.size}

    def _along(self, names: Sequence[str]) -> tuple[list[str], dict[str, str]]:
        """Return rates, path constraints and integrands in the names, and the intermediate values."""
        problem, phase, model = self.problem, self.phase, self.phase.model
        paths, bounds = phase.path_expression(), phase.get_path_bounds()
        column = ca.vertcat(
            model.state_derivative() * ca.DM(self.time / self.states),
            paths / ca.DM(_row_magnitude(bounds)),
            phase.integrand_expression() * (self.time / self.objective),
        )
        t, x, u, p = model.symbolic_arguments()
        column = ca.substitute(problem.substitute_parameters(phase, column), p, ca.DM(model.parameter_values))
        symbols = ca.vertcat(t, x, u, problem.parameter_symbols())
        scales = np.concatenate([[self.time], self.states, self.controls, self.parameters])
        return _texts(symbols, scales, column, names)

    def _ends(self, names: Sequence[str]) -> tuple[list[str], dict[str, str]]:
        """Return the objective, boundary constraints and the duration in the names of the ends."""
        problem, phase = self.problem, self.phase
        limits = problem.get_boundary_constraint_bounds()
        duration = (phase.final_time - phase.initial_time) / self.time
        rows = problem.constraint_expression() / ca.DM(_row_magnitude(limits))
        symbols = ca.vertcat(
            phase.end_states("initial"), phase.end_states("final"), phase.initial_time, phase.final_time,
            phase.integral_symbols(), problem.parameter_symbols(),
        )  # fmt: skip
        integrals = np.full(phase.integral_symbols().numel(), self.objective)
        scales = np.concatenate(
            [self.states, self.states, [self.time, self.time], integrals, self.parameters]
        )
        column = ca.vertcat(problem.cost / self.objective, rows, duration)
        return _texts(symbols, scales, column, names, expanded=True)


def _texts(
    symbols: Any, scales: Any, column: Any, names: Sequence[str], *, expanded: bool = False
) -> tuple[list[str], dict[str, str]]:
    """Return a column of expressions as texts in scaled names, and the intermediate values that they use.

    Raises
    ------
    KeyError
        An operation is not in `OPERATIONS`.
    """
    scaled = ca.SX.sym("scaled", symbols.numel())
    function = ca.Function(
        "column", [scaled], [ca.densify(ca.substitute(column, symbols, scaled * ca.DM(scales)))]
    )
    work: dict[int, str] = {}
    aux: dict[str, str] = {}
    results = [""] * column.numel()
    for k in range(function.n_instructions()):
        operation, inputs = function.instruction_id(k), function.instruction_input(k)
        if operation == ca.OP_OUTPUT:
            results[function.instruction_output(k)[1]] = work[inputs[0]]
            continue
        place = function.instruction_output(k)[0]
        if operation == ca.OP_CONST:
            work[place] = f"({function.instruction_constant(k)!r})"
        elif operation == ca.OP_INPUT:
            work[place] = names[inputs[1]]
        else:
            text = OPERATIONS[operation].format(*(work[i] for i in inputs))
            work[place] = f"({text})" if expanded else f"v{k}"
            if not expanded:
                aux[f"v{k}"] = text
    return results, aux


def _magnitude(samples: Any, *boxes: Interval) -> Any:
    """Return the largest finite magnitude of each row of samples and of its bounds; one if all are zero."""
    rows = [np.atleast_2d(samples), *(bound[:, None] for box in boxes for bound in (box.lower, box.upper))]
    rows = [np.where(np.isfinite(row), np.abs(row), 0.0).max(axis=1) for row in rows]
    largest = np.max(np.broadcast_arrays(*rows), axis=0)
    return np.where(largest > LEAST_MAGNITUDE, largest, 1.0)


def _row_magnitude(limits: Interval) -> Any:
    return _magnitude(np.zeros((limits.lower.size, 1)), limits) if limits.lower.size else np.zeros(0)


def _pair(box: Interval, scale: Any) -> list[list[float | None]]:
    """Return scaled lower and upper bounds of each row, None for no bound."""
    pairs = zip(box.lower / scale, box.upper / scale, strict=True)
    return [[float(v) if np.isfinite(v) else None for v in pair] for pair in pairs]


def _lines(rows: Any, scale: Any) -> list[list[float]]:
    """Return scaled samples of each row; the ends alone if they lie on a straight line."""
    scaled = rows / scale[:, None]
    lines = scaled[:, :1] + (scaled[:, -1:] - scaled[:, :1]) * FRACTIONS
    straight = np.abs(scaled - lines).max(axis=1) < 1e-9
    return [
        row[[0, -1]].tolist() if flat else row.tolist() for row, flat in zip(scaled, straight, strict=True)
    ]


def _limited(texts: Sequence[str], limits: Interval) -> list[dict[str, Any]]:
    scale = _row_magnitude(limits)
    return [
        {"expr": text, "lb": low, "ub": high}
        for text, (low, high) in zip(texts, _pair(limits, scale), strict=True)
    ]
