"""``python -m benchmarks.validation.published``."""

from benchmarks.validation.published.runner import main

if __name__ == "__main__":
    raise SystemExit(main())
