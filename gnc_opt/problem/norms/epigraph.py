r"""The form of a phase without other kinks: controls above what costs, several smooth limits for one with kinks.

The least s above all of :math:`e_0, \ldots, e_k` is the largest of them: so a control s takes the place of a kink that
costs, with a path constraint per piece (epigraph form; S. Boyd & L. Vandenberghe, Convex Optimization, Cambridge 2004,
section 4.1.3). The largest of them is within a limit if each of them is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.model.graph import replaced
from gnc_opt.model.layout import Variable
from gnc_opt.model.model import Model
from gnc_opt.model.symbol import Symbol
from gnc_opt.problem.constraint import Constraint
from gnc_opt.problem.guess.ends import guess_times
from gnc_opt.problem.guess.trajectory import start_phase
from gnc_opt.problem.guess.values import GuessValue
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.norms.domain import Domain
from gnc_opt.problem.norms.extrema import is_smooth, pieces, rows_of
from gnc_opt.problem.norms.kinks import Extremum, kinks_that_cost, limited_sense
from gnc_opt.problem.norms.phase_form import PhaseForm
from gnc_opt.problem.norms.succeed import free_name
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.phase_numbers import PhaseGuess
from gnc_opt.problem.restatement import Restatement
from gnc_opt.problem.statement import Statement


@dataclass(frozen=True, eq=False)
class Kinked:
    """What kinks of a phase have to be put aside.

    Attributes
    ----------
    costs : dict of list of Extremum
        By integral.
    limits : dict of Constraint
        Path constraints whose kinked rows are several smooth ones each.
    """

    costs: dict[str, list[Extremum]]
    limits: dict[str, Constraint]

    @classmethod
    def of(cls, problem: Statement, leg: Phase, domain: Domain) -> Kinked:
        """Find them."""
        _, x, u, _ = leg.model.arguments()
        found = kinks_that_cost(problem, leg, domain)
        costs = {
            name: [k for k in own if ca.depends_on(k.node, ca.vertcat(x, u))] for name, own in found.items()
        }
        limits = {name: smooth_limits(c, domain) for name, c in leg.paths.items()}
        return cls(
            {name: own for name, own in costs.items() if own},
            {name: c for name, c in limits.items() if c is not None},
        )

    @property
    def key(self) -> tuple[Any, ...]:
        """The same for the same form."""
        costs = ((name, *(k.node.element_hash() for k in own)) for name, own in self.costs.items())
        return (*costs, *((name, c.size) for name, c in self.limits.items()))


def smooth_limits(constraint: Constraint, domain: Domain) -> Constraint | None:
    """Return a constraint with smooth rows for each row that is the largest or least of them; None if there is none."""
    rows: list[tuple[Any, float, float]] = []
    box, changed = constraint.interval, False
    for i, row in enumerate(rows_of(constraint.expression)):
        sense = limited_sense(constraint, i)
        own = pieces(row, sense, domain) if sense and not is_smooth(row) else None
        changed |= own is not None
        kept = [e for e in own or [row] if own is None or not _holds(e, box.lower[i], box.upper[i])]
        rows += [(e, box.lower[i], box.upper[i]) for e in kept]
    if not changed or not rows:
        return None
    expressions, lower, upper = zip(*rows, strict=True)
    return Constraint(constraint.name, ca.vertcat(*expressions), Interval(np.array(lower), np.array(upper)))


def above_pieces(symbol: Symbol, kink: Extremum) -> tuple[Constraint, float]:
    """Return the constraint that keeps a symbol above the pieces of a kink, and the largest constant among them."""
    above = [kink.sense * e for e in kink.pieces]
    rows = [symbol - e for e in above if not e.is_constant()]
    constants = [float(e) for e in above if e.is_constant()]
    limits = Interval(np.zeros(len(rows)), np.full(len(rows), np.inf))
    return Constraint(symbol.variable.name, ca.vertcat(*rows), limits), max(constants, default=-np.inf)


def _holds(expression: Any, lower: float, upper: float) -> bool:
    """Whether an expression is a constant within limits."""
    return bool(expression.is_constant() and lower <= float(expression) <= upper)


@dataclass(frozen=True, eq=False)
class EpigraphForm(PhaseForm):
    """A phase with controls in place of kinks.

    Attributes
    ----------
    kinks : dict of Extremum
        By the control that takes its place.
    least : dict of float
        The least that those may be.
    """

    kinks: dict[str, Extremum]
    least: dict[str, float]

    @classmethod
    def of(cls, leg: Phase, kinked: Kinked) -> EpigraphForm:
        """Restate a phase with a control for each kink that costs."""
        old = leg.model
        symbols: dict[int, Symbol] = {}
        kinks, least, texts = {}, {}, []
        integrands, paths = dict(leg.integrands), {**leg.paths, **kinked.limits}
        for name, own in kinked.costs.items():
            for kink in own:
                place = kink.node.element_hash()
                if place in symbols:
                    continue
                s = symbols[place] = _new(old, len(symbols))
                label = s.variable.name
                kinks[label] = kink
                paths[label], least[label] = above_pieces(s, kink)
                texts.append(f"a kink of integral '{name}' is solved for as {label}, kept beyond its pieces")
            value = {k.node.element_hash(): k.sense * symbols[k.node.element_hash()] for k in own}
            symbol, integrand = integrands[name]
            integrands[name] = (symbol, replaced(integrand, value))
        texts += [f"'{n}' is solved for as {c.size} smooth limits" for n, c in kinked.limits.items()]
        none = ca.SX(0, 1)
        values = [ca.fmax(kink.sense * kink.node, least[label]) for label, kink in kinks.items()]
        controls = [*(old.symbol(name) for name in old.controls.names), *symbols.values()]
        return cls(
            old.in_controls(controls, [], lambda expression: expression),
            paths,
            integrands,
            Restatement(old, none, none, ca.vertcat(old.symbols("control"), *values), tuple(texts)),
            kinks,
            least,
        )

    def apply(self, problem: Statement, leg: Phase) -> None:
        """Give a phase this form with its own numbers."""
        stated = leg.clone()
        least = np.array([self.least[name] for name in self.kinks])
        box = leg.numbers.controls
        guess = leg.numbers.guess
        values = {
            name: along_guess(problem, stated, kink.sense * kink.node) for name, kink in self.kinks.items()
        }
        controls = Interval(
            np.concatenate([box.lower, least]), np.concatenate([box.upper, np.full(least.size, np.inf)])
        )
        guessed = PhaseGuess(guess.time, {**guess.values, **values})
        self.give(leg, replace(leg.numbers, controls=controls, guess=guessed))


def along_guess(problem: Statement, stated: Phase, column: Any) -> GuessValue:
    """Return the values of a column along the guess of a phase, as a function of time."""
    arguments = [*stated.model.arguments(), problem.parameter_symbols()]
    function = ca.Function("guessed", arguments, [ca.densify(problem.bind(stated, column))])
    q = np.concatenate([*problem.parameter_guess.values(), np.zeros(0)])

    def at(t: Any) -> Array:
        first, last = guess_times(stated)
        start = start_phase(stated, np.array([(t - first) / (last - first)]), perturbed=False)
        values = function(t, start.states[:, 0], start.controls[:, 0], stated.model.parameter_values, q)
        return np.asarray(values.full()[:, 0])

    return at


def _new(model: Model, k: int) -> Symbol:
    return Symbol(Variable(free_name(model, "epigraph" if k == 0 else f"epigraph_{k + 1}"), 1, ""))
