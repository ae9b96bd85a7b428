"""Robustness of the solver against its own constants.

    python -m benchmarks.validation.robustness [--draws 20] [--problems 40] [--single NAME ...] [--seed 1] [--json OUT]

The numeric constants of the solver's packages (`PACKAGES`) are read from their source. In every draw each is multiplied
by a factor of its own, distributed log-uniformly between 1/2 and 2; integers are rounded. All problems are then solved
and checked by the default call. A problem is lost where its objective was right, and its answer ok, with the constants
as they are, and is not with the scaled ones. ``--single`` halves and doubles one constant at a time instead; ``all``
stands for all of them.

Constants that are default values of parameters are read when a module is imported: they keep their values. So do
those of formulas (`FORMULAS`).
"""

from __future__ import annotations

import argparse
import ast
import importlib
import json
import math
import pkgutil
import statistics
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType

import numpy as np

import gnc_opt
from benchmarks.validation import engine

PACKAGES = (
    "gnc_opt.planning.direct",
    "gnc_opt.planning.optimality",
    "gnc_opt.planning.problem.reformulation",
    "gnc_opt.planning.refinement",
    "gnc_opt.planning.solution",
    "gnc_opt.planning.optimal_control_solver",
)
"""Where the constants of the solver are."""

MAX_FACTOR = 2.0
"""Constants are multiplied by up to this, and divided by it."""

FORMULAS = ("STEP_PARTS", "ORDER", "DEGREE")
"""Constants that belong to a formula: the nodes of an interpolation, the order of a method."""

QUICK_CPU_S = 4.0
"""Problems that take longer with the constants as they are do not take part."""

CPU_LIMIT_FACTOR, CPU_LIMIT_LEAST_S = 10.0, 20.0
"""CPU time after which a problem is lost: so many times what it takes otherwise, but at least so many seconds."""


@dataclass(frozen=True)
class Constant:
    """A numeric constant: the module that defines it, its name, and its value."""

    module: str
    name: str
    value: float

    def scaled(self, factor: float) -> float:
        """Return the value times a factor; an integer remains one, of at least 1."""
        if isinstance(self.value, int):
            return max(1, round(self.value * factor)) if self.value > 0 else self.value
        return self.value * factor


def constants() -> list[Constant]:
    """Return the constants of the solver's packages, in the order of modules and lines."""
    found: list[Constant] = []
    for name in _modules():
        module = importlib.import_module(name)
        for target, expression in _assigned(module):
            value = getattr(module, target)
            literal = isinstance(expression, ast.Constant) and type(value) in (int, float)
            if literal and target not in FORMULAS:
                found.append(Constant(name, target, value))
    return found


def _modules() -> Iterator[str]:
    for package in PACKAGES:
        module = importlib.import_module(package)
        yield package
        for child in pkgutil.walk_packages(getattr(module, "__path__", ()), f"{package}."):
            yield child.name


def _assigned(module: ModuleType) -> Iterator[tuple[str, ast.expr]]:
    """Yield the names in capitals that the statements of a module assign, and what they are."""
    assert module.__file__ is not None
    for statement in ast.parse(Path(module.__file__).read_text(encoding="utf-8")).body:
        if not isinstance(statement, ast.Assign) or len(statement.targets) > 1:
            continue
        target, value = statement.targets[0], statement.value
        pairs = [(target, value)]
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            pairs = list(zip(target.elts, value.elts, strict=True))
        yield from (
            (name.id, given) for name, given in pairs if isinstance(name, ast.Name) and name.id.isupper()
        )


def set_constants(values: Mapping[str, tuple[float, float]]) -> None:
    """Replace constants in all modules that hold them: by name, the value that they have and the one that they get.

    Constants that are computed from others follow.
    """
    for name, module in list(sys.modules.items()):
        if name.startswith(gnc_opt.__name__) and module is not None:
            for constant in values.keys() & vars(module).keys():
                old, new = values[constant]
                if vars(module)[constant] == old:
                    setattr(module, constant, new)
    for name in _modules():
        module = importlib.import_module(name)
        for constant, expression in _assigned(module):
            if type(getattr(module, constant)) in (int, float) and not isinstance(expression, ast.Constant):
                setattr(module, constant, eval(ast.unparse(expression), vars(module)))


# --- one problem with scaled constants ----------------------------------------------------------------------


def measure(
    values: Mapping[str, tuple[float, float]], case: engine.Case, set_file: Path, limit_s: float
) -> engine.Row:
    """Solve and check a problem with other constants; the process keeps them only as long."""
    set_constants(values)
    try:
        return engine.measure(case, set_file, limit_s)
    finally:
        set_constants({name: (new, old) for name, (old, new) in values.items()})


@dataclass(frozen=True)
class Bench:
    """Problems, the CPU time that each may take (s), and the processes that solve them."""

    cases: Sequence[engine.Case]
    limits_s: Sequence[float]
    set_file: Path

    def lost(self, values: Mapping[str, tuple[float, float]]) -> list[str]:
        """Return the names of the problems that are not right and ok with other constants."""
        rows = engine.run(self.cases, self.set_file, self.limits_s, partial(measure, values))
        return [row.problem for row in rows if not (row.right and row.ok)]


def benches(count: int, groups: Sequence[str], set_file: Path) -> Bench:
    """Return the problems that take part: evenly from all that are right, ok and quick as the constants are."""
    every = [case for case in engine.cases(groups, (), set_file) if not case.variant]
    chosen = [every[int(k)] for k in np.unique(np.linspace(0, len(every) - 1, 2 * count).astype(int))]
    rows = engine.run(chosen, set_file, CPU_LIMIT_LEAST_S)
    good = [
        (case, row)
        for case, row in zip(chosen, rows, strict=True)
        if row.right and row.ok and row.cpu_s < QUICK_CPU_S
    ]
    good = [good[int(k)] for k in np.unique(np.linspace(0, len(good) - 1, count).astype(int))]
    limits_s = [max(CPU_LIMIT_LEAST_S, CPU_LIMIT_FACTOR * row.cpu_s) for _, row in good]
    return Bench([case for case, _ in good], limits_s, set_file)


# --- all draws -----------------------------------------------------------------------------------------------


def draws(found: Sequence[Constant], count: int, seed: int) -> Iterator[dict[str, tuple[float, float]]]:
    """Yield the values of every draw by name of the constant: the present one and the scaled one."""
    generator = np.random.default_rng(seed)
    for _ in range(count):
        factors = np.exp(generator.uniform(-math.log(MAX_FACTOR), math.log(MAX_FACTOR), len(found)))
        yield {c.name: (c.value, c.scaled(float(f))) for c, f in zip(found, factors, strict=True)}


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what each draw, or each constant, loses."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.validation.robustness", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--draws", type=int, default=20, metavar="N")
    parser.add_argument("--problems", type=int, default=40, metavar="N")
    parser.add_argument("--single", nargs="+", default=(), metavar="NAME", help="constants, or all")
    parser.add_argument("--groups", nargs="+", choices=engine.GROUPS, default=engine.GROUPS, metavar="GROUP")
    parser.add_argument(
        "--set", type=Path, default=engine.SET_FILE, metavar="FILE", help="default: %(default)s"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the results to this file")
    given = parser.parse_args(arguments)
    found = constants()
    bench = benches(given.problems, given.groups, given.set)
    print(f"{len(found)} constants, {len(bench.cases)} problems")
    if given.single:
        tried = [c for c in found if "all" in given.single or c.name in given.single]
        trials = [
            (f"{c.name} = {c.scaled(factor):g}", {c.name: (c.value, c.scaled(factor))})
            for c in tried
            for factor in (1.0 / MAX_FACTOR, MAX_FACTOR)
            if c.scaled(factor) != c.value
        ]
    else:
        trials = [(f"draw {k + 1}", values) for k, values in enumerate(draws(found, given.draws, given.seed))]
    results: dict[str, list[str]] = {}
    for label, values in trials:
        results[label] = bench.lost(values)
        print(f"{label:40} {len(results[label]):3} lost  {', '.join(results[label])}", flush=True)
        if given.json is not None:
            given.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    counts = [len(lost) for lost in results.values()]
    if counts:
        print(f"lost: median {statistics.median(counts):g}, most {max(counts)}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
