"""``python -m problems.rocket_landing``: a campaign per law, and one table."""

from problems.rocket_landing import main

if __name__ == "__main__":
    raise SystemExit(main())
