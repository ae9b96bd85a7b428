"""``python -m problems.formation_flying``: the publication's numbers and the optima, one table."""

from problems.formation_flying import main

if __name__ == "__main__":
    raise SystemExit(main())
