"""What a solve cost."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Statistics:
    """What the solve cost.

    Attributes
    ----------
    iterations : int
        0 for a flight that is a solution as it is, of a bang-bang problem whose switches are found.
    build_s, solve_s : float
        Wall time of transcription and of the solver.
    function_s, linear_solver_s : float
        Shares of ``solve_s``: evaluating functions and derivatives; the rest.
    build_reused : bool
        Whether an earlier transcription served again.

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
    build_reused: bool = False

    @property
    def text(self) -> str:
        """In words, ``"12 iterations, build 0.046 s, solve 0.010 s"``."""
        if self.iterations == 0 and self.solve_s == 0.0:
            return "by Newton's method on switch times, no program solved on it"
        build = "build re-used" if self.build_reused else f"build {self.build_s:.3f} s"
        return (
            f"{self.iterations} iteration{'s' * (self.iterations != 1)}, {build}, solve {self.solve_s:.3f} s"
        )

    def after(self, earlier: Statistics) -> Statistics:
        """Return these together with what an earlier try of the same solve cost."""
        return replace(
            self,
            iterations=self.iterations + earlier.iterations,
            build_s=self.build_s + earlier.build_s,
            solve_s=self.solve_s + earlier.solve_s,
            function_s=self.function_s + earlier.function_s,
            linear_solver_s=self.linear_solver_s + earlier.linear_solver_s,
        )
