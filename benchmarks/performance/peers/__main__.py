"""``python -m benchmarks.performance.peers``."""

from benchmarks.performance.peers.compare import main

if __name__ == "__main__":
    raise SystemExit(main())
