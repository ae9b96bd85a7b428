"""Measures of the first runs of several campaigns, in the order of the campaigns."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.simulation import Campaign


def told(campaigns: dict[str, Campaign], value: Callable[[Campaign], Array], runs: int = 3) -> Array:
    """Return a measure of the first runs of each campaign, one campaign after the other."""
    return np.concatenate([value(campaign)[..., :runs] for campaign in campaigns.values()], axis=-1)
