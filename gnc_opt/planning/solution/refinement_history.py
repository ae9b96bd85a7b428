"""History of a mesh refinement: iterations, status and work.

Work is counted in iterations at one collocation point.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.renamed_public_names import StatusWord
from gnc_opt.text_html_and_json_formatting import PrintableResult, read_status_explanations


@dataclass(frozen=True)
class Statistics:
    """Iterations and times of a solve.

    Attributes
    ----------
    iterations : int
        0 if the solution of a bang-bang problem comes from integration with known switching times.
    build_s, solve_s : float
        Wall time of transcription and of the solver.
    function_s, linear_solver_s : float
        Parts of ``solve_s``: evaluation of functions and derivatives; the remainder.
    compiled_before : bool
        Whether an earlier transcription was reused.

    Examples
    --------
    >>> print(solution.statistics.iterations)
    0
    """

    iterations: int
    build_s: float
    solve_s: float
    function_s: float
    linear_solver_s: float
    compiled_before: bool = False

    @property
    def summary_text(self) -> str:
        """Text such as ``"12 iterations, transcription 0.046 s, solve 0.010 s"``."""
        if self.iterations == 0 and self.solve_s == 0.0:
            return "Newton's method on the switching times"
        build = "transcription reused" if self.compiled_before else f"transcription {self.build_s:.3f} s"
        return (
            f"{self.iterations} iteration{'s' * (self.iterations != 1)}, {build}, solve {self.solve_s:.3f} s"
        )

    def add_earlier(self, earlier: Statistics) -> Statistics:
        """Return the sum with the statistics of an earlier attempt."""
        summed = "iterations", "build_s", "solve_s", "function_s", "linear_solver_s"
        return replace(self, **{name: getattr(self, name) + getattr(earlier, name) for name in summed})


class RefinementStatus(StatusWord):
    """Status at the end of a refinement; `remedy` contains its meaning and a remedy.

    Examples
    --------
    >>> print(go.RefinementStatus.UNCHECKED.remedy.partition("; ")[0])
    The estimated error of the objective is within the tolerance
    """

    CONVERGED = "converged"
    CONDITIONS_FAIL = "conditions_fail"
    UNCHECKED = "unchecked"
    POINT_LIMIT = "point_limit"
    ITERATION_LIMIT = "iteration_limit"
    BUDGET_LIMIT = "budget_limit"
    STALLED = "stalled"
    FAILED = "failed"
    INTERRUPTED = "interrupted"

    @property
    def remedy(self) -> str:
        """Meaning of the status, and a remedy."""
        return _REMEDIES[self.value]


_REMEDIES = read_status_explanations("refinement")

SOLVE_FIXED_COST_ITERATIONS = 15
"""Work of a solve apart from its iterations (derivatives, error estimate, next mesh), in iterations."""


def compute_work_of_nlp_solve(size: int, iterations: int) -> float:
    """Return the work of a solve: iterations times points, or times variables at points; independent of the machine."""
    return size * float(iterations + SOLVE_FIXED_COST_ITERATIONS)


@dataclass(frozen=True)
class Actions:
    """Numbers of segments with increased degree, and of segments split into several, between two meshes."""

    raised: int = 0
    split: int = 0

    def __add__(self, other: Actions) -> Actions:
        return Actions(self.raised + other.raised, self.split + other.split)

    def __str__(self) -> str:
        parts = [f"{n} {word}" for word, n in vars(self).items() if n]
        return ", ".join(parts) or "-"


@dataclass(frozen=True)
class RefinementIteration:
    """Refinement iteration: meshes of the phases, segment boundaries in s (``times``), and the solution on them.

    The largest ``error`` (`gnc_opt.planning.refinement.collocation_error_estimate`) is at ``where``; ``iterations``
    include failed attempts; ``seconds`` those of solve and error estimate. ``actions`` are changes of the mesh before
    this solve; for a structure iteration, those that its solution requires. ``stage`` is one of
    `gnc_opt.planning.refinement.staged_refinement`.
    """

    meshes: dict[str, Mesh]
    times: dict[str, tuple[float, ...]]
    error: float
    where: str
    objective: float
    solved: bool
    iterations: int
    seconds: float
    actions: Actions | str
    stage: str = ""

    @property
    def n_points(self) -> int:
        """Number of collocation points of all phases."""
        return sum(mesh.size for mesh in self.meshes.values())

    @property
    def n_segments(self) -> int:
        """Number of segments of all phases."""
        return sum(mesh.segments for mesh in self.meshes.values())

    @property
    def work(self) -> float:
        """Work, in iterations at one collocation point."""
        return compute_work_of_nlp_solve(self.n_points, self.iterations)


@dataclass(frozen=True)
class History(PrintableResult):
    """History and result of a refinement.

    Attributes
    ----------
    status : RefinementStatus
    tolerance : float
        Requested tolerance.
    passes : tuple of RefinementIteration
        Refinement iterations, including abandoned ones. The first iteration of an hp refinement is the given solution.
    chosen : int
        Index of the iteration whose solution was returned.
    message : str
        Description of the end of the refinement, one or two sentences.
    seconds : float
        Total wall time: refinement iterations, structure search, optimality checks.
    first_solve : RefinementIteration or None
        Solve on the first mesh from which the arcs were detected, if it is not among ``passes``.

    Examples
    --------
    >>> print(solution.history.status.value, solution.history.final_iteration.error < 1e-6)
    converged True
    """

    status: RefinementStatus
    tolerance: float
    passes: tuple[RefinementIteration, ...]
    chosen: int
    message: str
    seconds: float = 0.0
    first_solve: RefinementIteration | None = None

    @property
    def converged(self) -> bool:
        """Whether the returned solution is within the tolerance and, after `refine`, passes the optimality check."""
        return self.status is RefinementStatus.CONVERGED

    @property
    def final_iteration(self) -> RefinementIteration:
        """Iteration whose solution was returned."""
        return self.passes[self.chosen]

    def __str__(self) -> str:
        head = f"{'iter':>4} {'segments':>8} {'points':>6} {'error':>8} {'objective':>18} {'NLP':>4} {'s':>6}"
        lines = [f"{head}  {'stage':<16} actions"]
        for i, p in enumerate(self.passes):
            mark = "*" if i == self.chosen else " "
            lines.append(
                f"{i:>3}{mark} {p.n_segments:>8} {p.n_points:>6} {p.error:>8.1e} {p.objective:>18.11g} "
                f"{p.iterations:>4} {p.seconds:>6.2f}  {p.stage:<16} {p.actions}"
            )
        return "\n".join([*lines, f"{self.message} ({self.seconds:.2f} s; *: returned, NLP: iterations)"])
