"""``python -m problems.tethered_formation``: table, optimal manoeuvres, their tracking."""

from problems.tethered_formation import main

if __name__ == "__main__":
    raise SystemExit(main())
