"""Relaxations: subproblems without the states that do not affect the others.

A set of states is closed if no derivative in it depends on other states; an example is attitude and rate of a
spacecraft without its position. Every feasible trajectory of the problem is feasible for a closed set, whose minimum
cost is therefore a lower bound.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.array_types import Mask
from gnc_opt.model.model_variables import Layout
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem


@dataclass(frozen=True, eq=False)
class Relaxation:
    """Problem with fewer states, with masks of the remaining components of states and controls by phase."""

    problem: Problem
    states: dict[str, Mask]
    controls: dict[str, Mask]


def list_problem_relaxations(problem: Problem) -> list[Relaxation]:
    """Return the relaxed problem of each maximal closed set that contains all states of the cost."""
    found = (
        _restrict_problem_to_state_subset(problem, part)
        for part in _select_maximal_state_subsets(list(_list_states_closed_under_dynamics(problem)))
    )
    return [relaxation for relaxation in found if relaxation is not None]


def _select_maximal_state_subsets(sets: list[Mask]) -> Iterator[Mask]:
    for i, own in enumerate(sets):
        if not any(np.all(other >= own) for j, other in enumerate(sets) if j != i):
            yield own


def _list_states_closed_under_dynamics(problem: Problem) -> Iterator[Mask]:
    """Yield the closure of each state, without duplicates, with at least one state in every phase."""
    phases = list(problem.phases.values())
    owner = np.repeat(np.arange(len(phases)), [phase.model.states.size for phase in phases])
    needs = np.eye(owner.size, dtype=bool)
    ties = [_find_states_in_end_expression(problem, problem.constraint_expression())]
    for i, phase in enumerate(phases):
        own, x = owner == i, phase.model.symbols("state")
        needs[np.ix_(own, own)] |= _build_jacobian_sparsity_mask(phase.model.state_derivative(), x)
        rows = np.zeros((phase.path_expression().numel(), owner.size), dtype=bool)
        rows[:, own] = _build_jacobian_sparsity_mask(phase.path_expression(), x)
        ties.append(rows)
    every = np.vstack(ties)
    # Phases stay linked: links couple states, even if other states are removed.
    linking = every[[np.unique(owner[row]).size > 1 for row in every]]
    known: set[bytes] = set()
    for rows in (every, linking):
        for closed in _compute_transitive_closure(needs | (rows.T.astype(int) @ rows > 0)):
            if (
                not closed.all()
                and closed.tobytes() not in known
                and np.unique(owner[closed]).size == len(phases)
            ):
                known.add(closed.tobytes())
                yield closed


def _compute_transitive_closure(needs: Mask) -> Mask:
    while True:
        more = (needs.astype(int) @ needs) > 0
        if np.array_equal(more, needs):
            return needs
        needs = more


def _build_jacobian_sparsity_mask(expression: Any, symbols: Any) -> Mask:
    pattern = np.zeros((expression.numel(), symbols.numel()), dtype=bool)
    if pattern.size:
        rows, columns = ca.jacobian_sparsity(expression, symbols).get_triplet()
        pattern[rows, columns] = True
    return pattern


def _find_states_in_end_expression(problem: Problem, expression: Any) -> Mask:
    columns = []
    for phase in problem.phases.values():
        ends = _build_jacobian_sparsity_mask(
            expression, phase.end_states("initial")
        ) | _build_jacobian_sparsity_mask(expression, phase.end_states("final"))
        along = _build_jacobian_sparsity_mask(phase.integrand_expression(), phase.model.symbols("state"))
        used = _build_jacobian_sparsity_mask(expression, phase.integral_symbols())
        columns.append(ends | ((used.astype(int) @ along) > 0))
    return np.hstack(columns)


class _ReducedPhase:
    def __init__(self, phase: Phase, states: Mask, integrals: Mask) -> None:
        self.phase, self.states = phase, states
        _, x, u, _ = phase.model.symbolic_arguments()
        rates, paths = phase.model.state_derivative()[np.flatnonzero(states)], phase.path_expression()
        self.integrands = {
            name: integrand
            for used, (name, (_, integrand)) in zip(integrals, phase.integrands.items(), strict=True)
            if used
        }
        moved = ca.vertcat(rates, *self.integrands.values())
        self.controls = np.any(_build_jacobian_sparsity_mask(moved, u), axis=0)
        alone = ~np.any(_build_jacobian_sparsity_mask(paths, x)[:, ~states], axis=1)
        limited = _build_jacobian_sparsity_mask(paths, u)
        self.rows = alone & ~np.any(limited, axis=1)
        while True:  # rows on remaining states and controls include their other controls
            more = alone & (self.rows | np.any(limited[:, self.controls], axis=1))
            if np.array_equal(more, self.rows):
                break
            self.rows = more
            self.controls = self.controls | np.any(limited[more], axis=0)
        self.rates, self.paths = rates, paths[np.flatnonzero(self.rows)]

    @property
    def stack_phase_expressions(self) -> Any:
        return ca.vertcat(self.rates, self.paths, *self.integrands.values())

    def build_model_with_fewer_states(self, used: set[int]) -> tuple[Model, Any, Any]:
        """Return the reduced model, and the old symbols with their replacements."""
        old, model = self.phase.model, Model(self.phase.model.name)
        t, x, u, p = old.symbolic_arguments()
        for layout, kept, declare in (
            (old.states, self.states, model.state),
            (old.controls, self.controls, model.control),
        ):
            for name, places in _list_retained_variable_components(layout, kept):
                v = layout[name]
                nominal = None if v.nominal is None else np.broadcast_to(v.nominal, v.size)[places]
                declare(name, len(places), unit=v.unit, nominal=nominal)
        parameters = np.array(
            [s.element_hash() in used for s in ca.vertsplit(p)] if p.numel() else [], dtype=bool
        )
        for name, places in _list_retained_variable_components(old.parameters, parameters):
            value = old.parameter_values[old.parameters.slice(name)][places]
            model.parameter(name, value, unit=old.parameters[name].unit)
        kept = ((x, self.states), (u, self.controls), (p, parameters))
        before = ca.vertcat(t, *(symbols[np.flatnonzero(mask)] for symbols, mask in kept))
        after = ca.vertcat(*model.symbolic_arguments())
        rates = _substitute_symbols(self.rates, before, after)
        model.ode({name: rates[model.states.slice(name)] for name in model.states.names})
        return model, before, after


def _restrict_problem_to_state_subset(problem: Problem, kept: Mask) -> Relaxation | None:
    """Return the problem of a closed set of states; None if the cost needs other states."""
    conditions, cost = problem.constraint_expression(), problem.cost
    if np.any(_find_states_in_end_expression(problem, cost)[:, ~kept]):
        return None
    alone = ~np.any(_find_states_in_end_expression(problem, conditions)[:, ~kept], axis=1)
    conditions = conditions[np.flatnonzero(alone)]
    ends = ca.vertcat(cost, conditions)
    parts, first = [], 0
    for phase in problem.phases.values():
        last = first + phase.model.states.size
        integrals = np.any(_build_jacobian_sparsity_mask(ends, phase.integral_symbols()), axis=0)
        parts.append(_ReducedPhase(phase, kept[first:last], integrals))
        first = last
    return _build_relaxed_problem(problem, parts, conditions, problem.get_boundary_constraint_bounds(), alone)


def _build_relaxed_problem(
    problem: Problem, parts: list[_ReducedPhase], conditions: Any, limits: Interval, alone: Mask
) -> Relaxation:
    used = {
        s.element_hash()
        for e in (problem.cost, conditions, *(p.stack_phase_expressions for p in parts))
        for s in ca.symvar(e)
    }
    states = ", ".join(
        dict.fromkeys(
            name
            for p in parts
            for name, _ in _list_retained_variable_components(p.phase.model.states, p.states)
        )
    )
    relaxed = Problem(f"{problem.name}, {states} alone")
    before, after = _declare_free_parameters(problem, relaxed, parts, used)
    stated, free = ca.vertcat(*before), ca.vertcat(*after)
    for part in parts:
        model, old, new = part.build_model_with_fewer_states(used)
        phase = relaxed.phase(part.phase.name, model)
        _declare_limits_of_reduced_phase(phase, part, ca.vertcat(old, stated), ca.vertcat(new, free))
        kept = np.flatnonzero(part.states)
        before += [old, part.phase.initial_time, part.phase.final_time]
        after += [new, phase.initial_time, phase.final_time]
        before += [part.phase.end_states("initial")[kept], part.phase.end_states("final")[kept]]
        after += [phase.end_states("initial"), phase.end_states("final")]
        before += [part.phase.integrands[name][0] for name in part.integrands]
        after += [phase.integrands[name][0] for name in part.integrands]
    cost, rows = (
        _substitute_symbols(e, ca.vertcat(*before), ca.vertcat(*after)) for e in (problem.cost, conditions)
    )
    for row, place in enumerate(np.flatnonzero(alone)):
        label = _convert_label_to_constraint_name(problem.constraint_labels()[place])
        relaxed.constrain(label, rows[row], lower=limits.lower[place], upper=limits.upper[place])
    (relaxed.minimize if problem.sense > 0 else relaxed.maximize)(cost)
    return Relaxation(
        relaxed, {p.phase.name: p.states for p in parts}, {p.phase.name: p.controls for p in parts}
    )


def _declare_free_parameters(
    problem: Problem, relaxed: Problem, parts: list[_ReducedPhase], used: set[int]
) -> tuple[list[Any], list[Any]]:
    """Declare the used free parameters with all their components; return old and new symbols."""
    before, after = [], []
    for name in problem.parameters.names:
        symbols = [problem.parameter_symbols()[problem.parameters.slice(name)]]
        symbols += [p.phase.model.symbol(name) for p in parts if name in p.phase.model.parameters]
        scalars = {s.element_hash() for column in symbols for s in ca.vertsplit(column)}
        if scalars & used:
            box, guess = problem.parameter_bounds[name], problem.parameter_guess[name]
            v = problem.parameters[name]
            after.append(
                relaxed.parameter(name, v.size, lower=box.lower, upper=box.upper, guess=guess, unit=v.unit)
            )
            before.append(symbols[0])
            used |= scalars
    return before, after


def _declare_limits_of_reduced_phase(phase: Phase, part: _ReducedPhase, before: Any, after: Any) -> None:
    """Declare the limits, path constraints and integrals of the reduced phase."""
    old, states, controls = part.phase.numbers, part.states, part.controls
    phase.numbers = replace(
        phase.numbers,
        initial_time=old.initial_time,
        final_time=old.final_time,
        duration=old.duration,
        initial=old.initial.select_components(states),
        final=old.final.select_components(states),
        states=old.states.select_components(states),
        controls=old.controls.select_components(controls),
    )
    limits = part.phase.get_path_bounds().select_components(part.rows)
    labels = [label for label, kept in zip(part.phase.path_labels, part.rows, strict=True) if kept]
    rows = _substitute_symbols(part.paths, before, after)
    for i, label in enumerate(labels):
        phase.path(
            _convert_label_to_constraint_name(label), rows[i], lower=limits.lower[i], upper=limits.upper[i]
        )
    for name, integrand in part.integrands.items():
        phase.integral(_substitute_symbols(integrand, before, after), name)


def _list_retained_variable_components(
    layout: Layout, kept: Iterable[bool]
) -> Iterator[tuple[str, list[int]]]:
    chosen = np.asarray(kept, dtype=bool)
    for name in layout.names:
        places = np.flatnonzero(chosen[layout.slice(name)]).tolist()
        if places:
            yield name, places


def _convert_label_to_constraint_name(label: str) -> str:
    return label.replace("[", " ").rstrip("]")


def _substitute_symbols(expression: Any, before: Any, after: Any) -> Any:
    """Return an expression in other symbols; phases with the same model repeat its symbols."""
    first = {s.element_hash(): i for i, s in reversed(list(enumerate(ca.vertsplit(before))))}
    places = list(first.values())
    return ca.substitute(expression, before[places], after[places])
