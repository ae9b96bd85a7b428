"""The form of a problem without kinks of its cost and boundary constraints: free parameters above what costs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.model.graph import operations_in, replaced
from gnc_opt.model.layout import Variable
from gnc_opt.model.symbol import Symbol
from gnc_opt.problem.constraint import Constraint
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.norms.domain import Domain
from gnc_opt.problem.norms.epigraph import above_pieces, smooth_limits
from gnc_opt.problem.norms.extrema import KINKED, outermost
from gnc_opt.problem.norms.kinks import extrema_of
from gnc_opt.problem.restatement import Restatement
from gnc_opt.problem.statement import Statement


def has_end_kinks(problem: Statement) -> bool:
    """Whether cost or boundary constraints hold a kink."""
    ends = ca.vertcat(0.0 if problem.cost is None else problem.cost, problem.constraint_expression())
    return bool({*KINKED} & problem.once(("operations", "ends"), lambda: operations_in(ends)))


@dataclass(frozen=True, eq=False)
class EndForm:
    """Cost and boundary constraints with free parameters in place of kinks.

    Attributes
    ----------
    cost : casadi.SX
    constraints : dict of Constraint
    parameters : dict of (Symbol, float)
        Those in place of kinks, and the least that they may be.
    texts : tuple of str
        What was restated.
    """

    cost: Any
    constraints: dict[str, Constraint]
    parameters: dict[str, tuple[Symbol, float]]
    texts: tuple[str, ...]

    @classmethod
    def of(cls, problem: Statement, domain: Domain) -> EndForm:
        """Restate a problem."""
        limits = {name: smooth_limits(c, domain) for name, c in problem.constraints.items()}
        changed = {name: c for name, c in limits.items() if c is not None}
        constraints, instead = {**problem.constraints, **changed}, {}
        parameters: dict[str, tuple[Symbol, float]] = {}
        taken = {*problem.parameters.names, *constraints}
        taken |= {name for leg in problem.phases.values() for name in leg.model.parameters.names}
        nodes = outermost(problem.cost, frozenset(), domain)
        for kink in extrema_of(problem.cost, nodes, int(problem.sense), domain):
            name = f"epigraph_of_cost_{len(parameters) + 1}"
            while name in taken:
                name += "_"
            symbol = Symbol(Variable(name, 1, ""))
            constraints[name], least = above_pieces(symbol, kink)
            parameters[name] = (symbol, least)
            instead[kink.node.element_hash()] = kink.sense * symbol
        texts = (
            *(
                f"a kink of the cost is solved for as parameter {name}, kept beyond its pieces"
                for name in parameters
            ),
            *(f"'{name}' is solved for as {c.size} smooth limits" for name, c in changed.items()),
        )
        return cls(replaced(problem.cost, instead), constraints, parameters, texts)

    @property
    def key(self) -> tuple[Any, ...]:
        """The same for the same form."""
        return tuple((name, c.size) for name, c in self.constraints.items())

    def apply(self, problem: Statement) -> None:
        """Give a problem this form."""
        for symbol, least in self.parameters.values():
            box = Interval(np.array([least]), np.full(1, np.inf))
            problem.add_parameter(symbol, box, np.array([max(least, 0.0)]))
        problem.cost, problem.constraints = self.cost, dict(self.constraints)
        if self.texts:
            leg = next(iter(problem.phases.values()))
            leg.restatement = Restatement.of_limits(leg.model, self.texts).after(leg.restatement)
