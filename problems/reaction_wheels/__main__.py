"""``python -m problems.reaction_wheels``: published slews, optimal slews and their tracking, three tables."""

from problems.reaction_wheels import main

if __name__ == "__main__":
    raise SystemExit(main())
