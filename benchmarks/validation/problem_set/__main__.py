"""``python -m benchmarks.validation.problem_set``."""

from benchmarks.validation.problem_set.solve import main

if __name__ == "__main__":
    raise SystemExit(main())
