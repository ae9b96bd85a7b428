"""``python -m benchmarks.performance.profile``."""

from benchmarks.performance.profile.compare import main

if __name__ == "__main__":
    raise SystemExit(main())
