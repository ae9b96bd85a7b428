"""Guesses by flying with the guessed controls: what is left where straight lines lead nowhere."""

from __future__ import annotations

import numpy as np

from gnc_opt.errors import ProblemError
from gnc_opt.problem.guess.simulate import simulate_guess
from gnc_opt.problem.guess.trajectory import start_phase
from gnc_opt.problem.problem import Problem

FRACTIONS = np.linspace(0.0, 1.0, 11)
"""Where guessed controls are looked at; they are flown with their means."""


def with_flown_guess(problem: Problem) -> Problem | None:
    """Return the problem with phase after phase flown from where the last one ends, its controls held as guessed.

    Such a guess follows the dynamics, and misses the ends. Controls stay as guessed. None if a flight cannot go on.
    """
    for name, leg in problem.phases.items():
        layout = leg.model.controls
        held = start_phase(leg, FRACTIONS).controls.mean(axis=1)
        law = {control: held[layout.slice(control)] for control in layout.names}
        try:
            flight = simulate_guess(problem, law, phase=name).phases[name].numbers.guess
        except ProblemError:
            return None
        states = {state: flight.values[state] for state in leg.model.states.names}
        problem = problem.with_guess(name, flight.time, **states)
    return problem
