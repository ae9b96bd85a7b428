"""Time to accuracy of gnc_opt and of other programs: ``python -m benchmarks.performance.peers``."""
