"""Tally: which samples are due, which were taken, and how long there has been none, in the memory of a filter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.control.estimation.augmented import Channel
from gnc_opt.control.estimation.chi_square import chi_square
from gnc_opt.model.layout import Layout, Variable
from gnc_opt.tolerances import LARGEST

LOST = "lost_steps"
"""The entry that counts control steps in a row that should have brought a sample and brought none."""


def counters(channels: Sequence[Channel]) -> list[Variable]:
    """Return the entries of a memory that are counted in, `LOST` last."""
    entries = []
    for channel in channels:
        entries += [Variable(f"{channel.name}_{what}") for what in ("nis", "taken", "refused")]
        if channel.counted:
            entries.append(Variable(f"{channel.name}_next"))
    return [*entries, Variable(LOST)]


class Tally:
    """The samples of one control step.

    Parameters
    ----------
    memory : Layout
    z : casadi SX (n_memory, 1)

    Attributes
    ----------
    entries : dict of str to SX
        Of the memory, by name; `take` and `told` move the counters on.
    """

    def __init__(self, memory: Layout, z: Any) -> None:
        self.entries = {name: z[memory.slice(name)] for name in memory.names}
        self._any_due, self._any_taken = ca.SX(0), ca.SX(0)

    def due(self, channel: Channel) -> Any:
        """Return whether a sample is expected now."""
        return self.entries[f"{channel.name}_next"] < 0.5 if channel.counted else ca.SX(1)

    def good(self, channel: Channel, sample: Any) -> Any:
        """Return whether one is, and has come."""
        whole = ca.sum1(ca.fabs(sample) <= LARGEST) == sample.shape[0]
        return ca.logic_and(whole, self.due(channel)) if channel.counted else whole

    def take(self, channel: Channel, good: Any, nis: Any) -> Any:
        """Count a sample with its normalised innovation squared; return whether it passes the gate."""
        name, gate = channel.name, channel.measurement.gate
        taken = good
        if gate is not None:
            passes = nis <= chi_square(channel.space.errors, gate)
            taken = ca.logic_and(good, passes)
            self.entries[f"{name}_refused"] += ca.logic_and(good, ca.logic_not(passes))
        due = self.due(channel)
        self.entries[f"{name}_nis"] += ca.if_else(taken, nis, 0)
        self.entries[f"{name}_taken"] += taken
        if channel.counted:
            left = self.entries[f"{name}_next"]
            self.entries[f"{name}_next"] = ca.if_else(due, channel.period - 1, left - 1)
        self._any_due, self._any_taken = ca.fmax(self._any_due, due), ca.fmax(self._any_taken, taken)
        return taken

    def told(self, x: Any, hold: int) -> Any:
        """Return the states x, or what is no number if samples have failed to come for longer than ``hold`` steps."""
        lost = ca.if_else(self._any_taken, 0, self.entries[LOST] + self._any_due)
        self.entries[LOST] = lost
        return ca.if_else(lost < hold + 0.5, x, np.nan)
