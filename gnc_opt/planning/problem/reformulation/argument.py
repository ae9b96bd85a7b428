"""Norms of what is more than controls, ``norm_2(u - v)`` in a cost: a control takes the place of their argument."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.model.expressions import ROOTS, nodes_of, replaced
from gnc_opt.model.variables import Symbol, Variable
from gnc_opt.planning.problem.constraints import Constraint
from gnc_opt.planning.problem.guess.values import GuessValue
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.planning.problem.interval_arithmetic import Domain, drawn
from gnc_opt.planning.problem.phase import Phase, PhaseGuess
from gnc_opt.planning.problem.reformulation.epigraph import along_guess, integral_senses
from gnc_opt.planning.problem.reformulation.phase_form import PhaseForm, free_name
from gnc_opt.planning.problem.restatement import Restatement
from gnc_opt.planning.problem.statement import Statement


@dataclass(frozen=True, eq=False)
class Argument:
    """The vector of a norm that costs.

    Attributes
    ----------
    integral : str
    root : casadi.SX
        The norm.
    vector : casadi.SX
        (k, 1), k > 1.
    """

    integral: str
    root: Any
    vector: Any


def argument_of_norm(problem: Statement, leg: Phase, domain: Domain) -> Argument | None:
    """Return the first norm of functions of controls of which less is better, and that is not zero where controls are.

    (A length of a path, whose argument is zero at rest only, stays as it is.)
    """
    senses = integral_senses(problem, leg)
    for name, (_, integrand) in leg.integrands.items():
        for root in nodes_of(integrand) if senses[name] else ():
            squares = _squares(root) if root.op() in ROOTS else None
            if squares is None or not _is_shifted(ca.vertcat(*squares), leg.model.symbols("control")):
                continue
            if senses[name] * domain.directions(integrand, [root])[0] > 0:
                return Argument(name, root, ca.vertcat(*squares))
    return None


def _is_shifted(vector: Any, controls: Any) -> bool:
    still = ca.substitute(vector, controls, ca.SX.zeros(controls.numel()))
    return bool(ca.depends_on(vector, controls) and np.any(drawn(still) != 0))


def _squares(root: Any) -> list[Any] | None:
    """Return of what a root is the norm."""
    if root.op() == ca.OP_HYPOT:
        return [root.dep(0), root.dep(1)]
    waiting, found = [root.dep(0)], []
    while waiting:
        node = waiting.pop()
        if node.op() == ca.OP_ADD:
            waiting += [node.dep(1), node.dep(0)]
        elif node.op() == ca.OP_SQ:
            found.append(node.dep(0))
        else:
            return None
    return found if len(found) > 1 else None


@dataclass(frozen=True, eq=False)
class ArgumentForm(PhaseForm):
    """A phase with a control in place of the argument of a norm.

    Attributes
    ----------
    control : Symbol
    argument : Argument
    """

    control: Symbol
    argument: Argument

    @classmethod
    def of(cls, leg: Phase, argument: Argument) -> ArgumentForm:
        """Restate a phase."""
        old, size = leg.model, argument.vector.numel()
        z = Symbol(Variable(free_name(old, "argument"), size, ""))
        name, zero = z.variable.name, np.zeros(size)
        symbol, integrand = leg.integrands[argument.integral]
        norm = {argument.root.element_hash(): ca.norm_2(z)}
        controls = [*(old.symbol(control) for control in old.controls.names), z]
        none = ca.SX(0, 1)
        text = f"the argument of a norm of integral '{argument.integral}' is solved for as {name}"
        return cls(
            old.in_controls(controls, [], lambda expression: expression),
            {**leg.paths, name: Constraint(name, z - argument.vector, Interval(zero, zero))},
            {**leg.integrands, argument.integral: (symbol, replaced(integrand, norm))},
            Restatement(old, none, none, ca.vertcat(old.symbols("control"), argument.vector), (text,)),
            z,
            argument,
        )

    def apply(self, problem: Statement, leg: Phase) -> None:
        """Give a phase this form with its own numbers."""
        name, size = self.control.variable.name, self.control.variable.size
        guess, box = leg.numbers.guess, leg.numbers.controls
        value: GuessValue = along_guess(problem, leg.clone(), self.argument.vector)
        controls = Interval(
            np.concatenate([box.lower, np.full(size, -np.inf)]),
            np.concatenate([box.upper, np.full(size, np.inf)]),
        )
        guessed = PhaseGuess(guess.time, {**guess.values, name: value})
        self.give(leg, replace(leg.numbers, controls=controls, guess=guessed))
