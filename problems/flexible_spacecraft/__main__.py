"""``python -m problems.flexible_spacecraft``: the publication's numbers and the optimal slews, one table."""

from problems.flexible_spacecraft import main

if __name__ == "__main__":
    raise SystemExit(main())
