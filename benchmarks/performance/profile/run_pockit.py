"""pockit: adaptive Radau collocation from ten intervals of ten points to its default error tolerance, 1e-8.

It compiles the functions of each problem; they are kept in files. The second way finds them there.
"""

import math
import tempfile
from pathlib import Path

import numpy as np
import sympy as sp
from pockit.optimizer import ipopt
from pockit.radau import System, constant_guess
from statement import IPOPT_OPTIONS, report

INTERVALS, POINTS, MAX_SOLVES = 10, 10, 10
OPTIONS = {k.removeprefix("ipopt."): v for k, v in IPOPT_OPTIONS.items() if k.startswith("ipopt.")}
FREE = (-math.inf, math.inf)


class _StaticParameters:
    """Free parameters of the problem, and all times and end states that are not fixed."""

    def __init__(self, stated):
        self.names, self.bounds, self.guess = [], [], []
        self.free = self._add(
            "p", stated.parameter_bounds, [FREE] * len(stated.parameters), stated.parameter_guess
        )
        first, last = ([samples[k] for samples in stated.state_guess] for k in (0, -1))
        self.first = self._add("a", stated.initial, stated.state_bounds, first)
        self.last = self._add("b", stated.final, stated.state_bounds, last)
        self.times = self._add(
            "time", (stated.initial_time, stated.final_time), [FREE] * 2, stated.time_guess
        )

    def _add(self, kind, ranges, boxes, guesses):
        """Return numbers for fixed values and names for others, which become parameters."""
        values = []
        for i, ((a, b), (c, d), guess) in enumerate(zip(ranges, boxes, guesses, strict=True)):
            low, high = max(a, c), min(b, d)
            values.append(float(low) if low == high else f"{kind}{i}")
            if low < high:
                self.names.append(f"{kind}{i}")
                self.bounds.append((low, high))
                self.guess.append(guess)
        return values


def solver_of(folder):
    """Return a solver that keeps compiled functions in a folder."""

    def solve(stated):
        cache = f"{folder}/{stated.name}"
        static = _StaticParameters(stated)
        system = System(static.names)
        symbols = dict(zip(static.names, system.s, strict=True))
        free, first, last, times = (
            [symbols.get(value, value) for value in values]
            for values in (static.free, static.first, static.last, static.times)
        )
        phase = system.new_phase(stated.states, stated.controls)
        rates, paths, integrands = stated.along(sp, phase.t, phase.x, phase.u, free)
        phase.set_dynamics(rates, cache=f"{cache}/rates")
        phase.set_integral(integrands, cache=f"{cache}/integrals")
        bounds = [*stated.state_bounds, *stated.control_bounds, *stated.path_bounds]
        limits = _limited([*phase.x, *phase.u, *paths], bounds)
        phase.set_phase_constraint(*limits, cache=f"{cache}/paths")
        phase.set_boundary_condition(first, last, *times, cache=f"{cache}/ends")
        phase.set_discretization(INTERVALS, POINTS)
        objective, events = stated.ends(sp, times, first, last, list(phase.I), free)
        system.set_phase([phase]).set_objective(stated.sense * objective, cache=f"{cache}/objective")
        rows, bounds = [*system.s, *events], [*static.bounds, *stated.event_bounds]
        if isinstance(times[1] - times[0], sp.Expr):
            rows.append(times[1] - times[0])
            bounds.append((0.0, math.inf))
        system.set_system_constraint(*_limited(rows, bounds), cache=f"{cache}/events")
        value = _guess(stated, phase)
        value = [value, static.guess] if static.names else value
        for count in range(MAX_SOLVES):
            value = system.refine(value) if count else value
            value, found = ipopt.solve(system, value, OPTIONS)
            if found["status"] not in (0, 1):  # solved, solved to the acceptable level
                raise RuntimeError(found["status_msg"].decode())
            if system.check(value):
                break
        return stated.sense * found["obj_val"]

    return solve


def _limited(rows, bounds):
    """Return the rows that have a bound, with their lower and upper bounds."""
    kept = [(sp.sympify(r), *pair) for r, pair in zip(rows, bounds, strict=True) if pair != FREE]
    return tuple(map(list, zip(*kept, strict=True))) if kept else ([], [], [])


def _guess(stated, phase):
    guess = constant_guess(phase, 0.0)
    guess.t_0, guess.t_f = start, end = stated.time_guess
    for kept, nodes, group in ((guess.x, guess.t_x, 0), (guess.u, guess.t_u, 1)):
        columns = [stated.line((node - start) / (end - start))[group] for node in nodes]
        for i, row in enumerate(np.array(columns).T):
            kept[i] = row
    return guess


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "di_min_energy").mkdir()
        report({"10x10 refined": solver_of(folder), "10x10 refined, compiled before": solver_of(folder)})
