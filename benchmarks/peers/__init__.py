"""Time to accuracy of gnc_opt and of other programs: ``python -m benchmarks.peers``."""

from benchmarks.peers.compare import main

__all__ = ["main"]
