"""Performance profiles of gnc_opt and other programs over the one-phase problems of the JSON set."""

from benchmarks.performance.profile.compare import main

__all__ = ["main"]
