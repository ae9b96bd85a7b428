"""A one-phase problem of the JSON set for every program alike, and how each program's solves are timed.

Runs in the environment of each program: it needs nothing but the standard library. The guess is the same for all:
states on straight lines between their known ends (a known end alone is kept, no known end is zero), or the samples
that the file gives; controls in the middle of their bounds, zero if one is infinite, or as the file gives; times
likewise.
"""

import json
import math
import os
import resource
import sys
import time

LIMIT_S = 60.0
"""CPU time of one solve, s."""
IPOPT_OPTIONS = {
    "ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.tol": 1e-8, "ipopt.max_iter": 3000
}  # fmt: skip
"""Options of IPOPT for programs on CasADi."""


class Statement:
    """Names, limits (pairs), guesses (samples at equal distances) and expressions of a problem."""

    def __init__(self, document):
        """Read a document."""
        phase = self.phase = document["phases"][0]
        self.document, self.name = document, document["name"]
        self.constants = {"pi": math.pi}
        for name, expression in document["constants"].items():
            self.constants[name] = self._number(expression)
        self.sense = -1.0 if document.get("sense", "min") == "max" else 1.0
        states, controls, free = phase["states"], phase["controls"], document["parameters"]
        self.states, self.controls, self.parameters = (
            [e["name"] for e in entries] for entries in (states, controls, free)
        )
        self.integrals = list(phase["integrals"])
        self.initial, self.final = ([self._range(e[key]) for e in states] for key in ("x0", "xf"))
        self.state_bounds, self.control_bounds, self.parameter_bounds = (
            [self._box(e) for e in entries] for entries in (states, controls, free)
        )
        self.path_bounds = [self._box(e) for e in phase["path"]]
        self.event_bounds = [self._box(e) for e in document["events"]]
        self.initial_time, self.final_time = self._range(phase["t0"]), self._range(phase["tf"])
        given = phase.get("tguess")
        ends = (self.initial_time, self.final_time)
        self.time_guess = tuple(map(self._number, given)) if given else tuple(_middle(*e) for e in ends)
        self.state_guess = [
            self._line(e, *ends) for e, *ends in zip(states, self.initial, self.final, strict=True)
        ]
        self.control_guess = [self._control(e) for e in controls]
        self.parameter_guess = [self._number(e["guess"]) for e in free]

    def along(self, functions, t, x, u, p):
        """Return rates, path functions and integrands; ``functions`` has sin, cos, exp, log, sqrt."""
        names = {**self.constants, **vars_of(functions), "t": t}
        for keys, values in ((self.states, x), (self.controls, u), (self.parameters, p)):
            names.update(zip(keys, values, strict=True))
        for name, expression in self.phase["aux"].items():
            names[name] = _value(expression, names)
        return (
            [_value(self.phase["ode"][name], names) for name in self.states],
            [_value(entry["expr"], names) for entry in self.phase["path"]],
            [_value(self.phase["integrals"][name], names) for name in self.integrals],
        )

    def ends(self, functions, times, first, last, integrals, p):
        """Return objective (as stated, not negated) and event functions."""
        names = {**self.constants, **vars_of(functions), "t_i1": times[0], "t_f1": times[1]}
        names.update(zip([f"{name}_i1" for name in self.states], first, strict=True))
        names.update(zip([f"{name}_f1" for name in self.states], last, strict=True))
        names.update(zip([f"{name}_1" for name in self.integrals], integrals, strict=True))
        names.update(zip(self.parameters, p, strict=True))
        events = [_value(entry["expr"], names) for entry in self.document["events"]]
        return _value(self.document["objective"], names), events

    def line(self, share):
        """Return states and controls of the guess at a share of the phase."""
        return tuple([_interpolated(s, share) for s in g] for g in (self.state_guess, self.control_guess))

    def guess_samples(self):
        """Return times and rows of states and of controls of the guess, all of the same length."""
        count = max(map(len, self.state_guess + self.control_guess))
        shares = [k / (count - 1) for k in range(count)]
        first, last = self.time_guess
        rows = [
            [[_interpolated(s, share) for share in shares] for s in g]
            for g in (self.state_guess, self.control_guess)
        ]
        return [first + share * (last - first) for share in shares], *rows

    def _number(self, expression):
        return float(_value(expression, {**self.constants, **vars_of(math)}))

    def _range(self, value):
        """Return (lower, upper) of a number, a pair or null."""
        if not isinstance(value, list):
            return (-math.inf, math.inf) if value is None else (self._number(value),) * 2
        low, high = value
        low = -math.inf if low is None else self._number(low)
        return low, math.inf if high is None else self._number(high)

    def _box(self, entry):
        return self._range([entry.get("lb"), entry.get("ub")])

    def _line(self, entry, first, last):
        if entry.get("guess") is not None:
            return self._pair(entry["guess"])
        known = [low if low == high else None for low, high in (first, last)]
        values = [v for v in known if v is not None] or [_clipped(0.0, *self._box(entry))]
        return values[0], values[-1]

    def _control(self, entry):
        if entry.get("guess") is not None:
            return self._pair(entry["guess"])
        return (_middle(*self._box(entry)),) * 2

    def _pair(self, guess):
        return tuple(map(self._number, guess)) if isinstance(guess, list) else (self._number(guess),) * 2


def vars_of(functions):
    """Return the functions that expressions use."""
    return {name: getattr(functions, name) for name in ("sin", "cos", "tan", "exp", "log", "sqrt", "tanh")}


def limits_of(value, pair):
    """Yield the conditions that keep a symbolic value within a pair."""
    low, high = pair
    if low == high:
        yield value == low
        return
    if math.isfinite(low):
        yield value >= low
    if math.isfinite(high):
        yield value <= high


def _value(expression, names):
    """Evaluate an expression of the file, which is the user's own and trusted."""
    return eval(str(expression), {"__builtins__": {}}, names)


def _middle(low, high):
    return 0.5 * (low + high) if math.isfinite(low + high) else _clipped(0.0, low, high)


def _interpolated(samples, share):
    """Return the value at a share of the length of samples at equal distances."""
    place = share * (len(samples) - 1)
    k = min(int(place), len(samples) - 2)
    return samples[k] + (place - k) * (samples[k + 1] - samples[k])


def _clipped(value, low, high):
    return min(max(value, low), high)


def report(ways):
    """Solve what the command line names, ``FILE NAME ...``, in every way; print a line of JSON for each solve.

    Every solve has a process of its own, forked after the imports and a first solve, and at most `LIMIT_S` of CPU
    time.

    Parameters
    ----------
    ways : dict
        Functions of the statement that state and solve the problem and return its objective, by name.
    """
    path, names = sys.argv[1], sys.argv[2:]
    with open(path, encoding="utf-8") as file:
        found = {document["name"]: document for document in json.load(file) if len(document["phases"]) == 1}
    for solve in ways.values():
        _timed(solve, found["di_min_energy"])
    for name in names:
        for way, solve in ways.items():
            print(json.dumps({"problem": name, "way": way, **_forked(solve, found[name])}), flush=True)


def _forked(solve, document):
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        os.close(reading)
        limit = math.ceil(time.process_time() + LIMIT_S)
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
        try:
            results = _timed(solve, document)
        except BaseException as error:  # whatever a program raises, the others go on
            results = {"failed": f"{type(error).__name__}: {error}"[:200]}
        os.write(writing, json.dumps(results).encode())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        results = pipe.read()
    os.waitpid(child, 0)
    return json.loads(results) if results else {"failed": f"stopped after {LIMIT_S:g} s of CPU time"}


def _timed(solve, document):
    begin = time.process_time()
    objective = float(solve(Statement(document)))
    return {"objective": objective, "seconds": time.process_time() - begin}
