"""Time-optimal rendezvous: the publication's minimum times beside ours, on its mesh and refined.

Mousavi and Esmailifar, J. Space Science, Technology and Applications 1 (2), 147-166, 2022. What its numbers are that
differ, other local minima, is found by `benchmarks.validation.rendezvous_minima`.
"""

from __future__ import annotations

from collections.abc import Iterator

import gnc_opt as go
from benchmarks.validation.published.comparison import Value
from problems.rendezvous import model, optimal


def values() -> Iterator[Value]:
    """Yield every computed quantity of the table; each equation is transcribed once."""
    yield from _data()
    problems = {equation: model.build(equation=equation) for equation in model.EQUATIONS}
    solutions = {
        (case, equation): go.solve(problem.with_initial(r_L=list(place)), mesh=model.PAPER_MESH, tol=None)
        for equation, problem in problems.items()
        for case, place in model.CASES.items()
    }
    yield from _size(solutions[1, model.EQUATIONS[0]])
    for (case, equation), solution in solutions.items():
        t_f = solution.objective
        yield Value(f"case {case}, {equation} equation: minimum time (s)", t_f)
        for key in ("paper GPM", "paper GPOPS"):
            if key in optimal.REFERENCE[case, equation]:
                yield Value(f"case {case}, {key}", t_f)


def _data() -> Iterator[Value]:
    yield Value("data: final sigma, y", model.FINAL_SIGMA[1])
    yield Value("data: segments and points of each", (model.PAPER_MESH.segments, model.PAPER_MESH.degrees[0]))
    for case, place in model.CASES.items():
        yield Value(f"data: first position, case {case} (m)", place)
    yield Value("data: formula of the final sigma, y", model.FINAL_SIGMA[1])


def _size(solution: go.Solution) -> Iterator[Value]:
    """Yield the size of the program, counted from what is unknown and what has to hold."""
    leg = solution.phase()
    states, controls = leg.states.size, leg.controls.size
    points, segments = leg.mesh.size, leg.mesh.segments
    yield Value("variables of the programme", (points + segments + 1) * states + points * controls + 1)
    # collocation at every point, the end of every segment by quadrature; the ends themselves are fixed by bounds
    yield Value("constraints of the programme", (points + segments) * states)
