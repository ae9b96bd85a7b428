"""``python -m problems.rendezvous_tracking``: one campaign per controller, one table, figures."""

from problems.rendezvous_tracking import main

if __name__ == "__main__":
    raise SystemExit(main())
