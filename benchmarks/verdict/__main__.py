"""``python -m benchmarks.verdict``."""

from benchmarks.verdict import main

if __name__ == "__main__":
    raise SystemExit(main())
