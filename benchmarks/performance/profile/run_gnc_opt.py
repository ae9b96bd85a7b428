"""gnc_opt: the default call, which checks optimality, and the objective alone to a tolerance."""

import copy

from statement import report

import gnc_opt as go
from benchmarks.validation.problem_set.reader import build_problem


def solver_of(**options):
    """Return a solver by ``go.solve`` with these options, from the common guess."""

    def solve(stated):
        document = copy.deepcopy(stated.document)
        phase = document["phases"][0]
        phase["tguess"], *rows = stated.guess_samples()
        for entries, guesses in zip((phase["states"], phase["controls"]), rows, strict=True):
            for entry, guess in zip(entries, guesses, strict=True):
                entry["guess"] = list(guess)
        solution = go.solve(build_problem(document), throw=False, **options)
        if not solution.status.solved:
            raise RuntimeError(solution.status.value)
        return solution.objective

    return solve


if __name__ == "__main__":
    report(
        {
            "default call, with optimality check": solver_of(),
            "tol=1e-4, check=False": solver_of(tol=1e-4, check=False),
            "tol=1e-8, check=False": solver_of(tol=1e-8, check=False),
        }
    )
