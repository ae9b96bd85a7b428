"""``python -m problems.rendezvous``: all cases beside the paper's, verdicts, figures."""

from problems.rendezvous import main

if __name__ == "__main__":
    raise SystemExit(main())
