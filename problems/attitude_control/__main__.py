"""``python -m problems.attitude_control``: a campaign per law, and one table."""

from problems.attitude_control import main

if __name__ == "__main__":
    raise SystemExit(main())
