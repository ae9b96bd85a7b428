"""What a search from many starts found, as JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from gnc_opt.refine.search.multistart import Multistart
from gnc_opt.report.summary_json import summary_dict


def search_dict(found: Multistart) -> dict[str, Any]:
    """Return what a search found as plain JSON values; each minimum with the summary of its solution.

    Parameters
    ----------
    found : Multistart

    Examples
    --------
    >>> from gnc_opt.report import search_dict
    >>> told = search_dict(go.multistart(problem, n=2, seed=1, executor="serial", refine=False))
    >>> print(told["finished"], len(told["minima"]))
    2 1
    """
    return {
        "problem": found.problem_name,
        "starts": found.starts,
        "finished": found.finished,
        "seed": found.seed,
        "interrupted": found.interrupted,
        "failures": dict(found.failures),
        "minima": [
            {
                "objective": minimum.objective,
                "hits": minimum.hits,
                "starts": list(minimum.starts),
                "trajectories": minimum.trajectories,
                "coarse_objectives": list(minimum.coarse_objectives),
                "refined": minimum.refined,
                "verdict_ok": minimum.verdict_ok,
                "standing": minimum.standing,
                "solution": summary_dict(minimum.solution),
            }
            for minimum in found.minima
        ],
    }


def search_text(found: Multistart) -> str:
    """Return `search_dict` as indented JSON text with a trailing newline."""
    return json.dumps(search_dict(found), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def write_search(path: str | Path, found: Multistart) -> Path:
    """Write `search_dict` to a file as UTF-8 JSON; returns its path.

    Parameters
    ----------
    path : str or Path
    found : Multistart

    Returns
    -------
    Path

    Raises
    ------
    OSError
        The file cannot be written.

    Examples
    --------
    >>> from gnc_opt.report import write_search
    >>> print(write_search("search.json", go.multistart(problem, n=2, seed=1, executor="serial", refine=False)))
    search.json
    """
    target = Path(path)
    target.write_text(search_text(found), encoding="utf-8")
    return target
