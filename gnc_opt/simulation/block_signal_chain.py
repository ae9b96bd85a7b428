"""Named signals in a chain of blocks, and the layout of their columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import casadi as ca

from gnc_opt.errors import ArgumentError, unknown_name_error
from gnc_opt.model.model_variables import Layout
from gnc_opt.simulation.intersample_actuator_output import ActuatorWaveform
from gnc_opt.simulation.sensor_and_actuator_block import Block, slice_symbolic_rows


@dataclass(frozen=True)
class ColumnLayout:
    """Layout of a column: names and sizes of its consecutive parts."""

    parts: tuple[tuple[str, int], ...]

    @property
    def size(self) -> int:
        return sum(n for _, n in self.parts)

    @cached_property
    def slices(self) -> dict[str, slice]:
        slices, first = {}, 0
        for name, n in self.parts:
            slices[name], first = slice(first, first + n), first + n
        return slices

    def split_vector_by_name(self, column: Any) -> dict[str, Any]:
        """Return the parts (rows) of a column or an array by name."""
        if isinstance(column, (ca.SX, ca.MX)):
            return {
                name: slice_symbolic_rows(column, place.start, place.stop)
                for name, place in self.slices.items()
            }
        return {name: column[place] for name, place in self.slices.items()}

    def stack_vector_by_name(self, values: Mapping[str, Any]) -> Any:
        return ca.vertcat(*[values[name] for name, _ in self.parts])


Kinds = dict[str, tuple[int, str]]
"""Sizes and units of signals by name."""


@dataclass(frozen=True)
class BlockLink:
    """Block with the names, size and unit of its input signals, and its output signals."""

    block: Block
    on: tuple[str, ...]
    size: int
    unit: str
    outputs: Kinds


def get_signal_sizes_and_units(layout: Layout) -> Kinds:
    return {v.name: (v.size, v.unit) for v in layout.variables}


def connect_block_chain(blocks: Sequence[Block], signals: Kinds, what: str) -> tuple[list[BlockLink], Kinds]:
    """Return the links of a chain of blocks, and the signals after the last block.

    Raises
    ------
    UnknownNameError
        A block acts on a signal that does not exist.
    """
    links = []
    for block in blocks:
        on = tuple(signals) if block.on is None else (block.on,) if isinstance(block.on, str) else block.on
        for name in on:
            if name not in signals:
                raise unknown_name_error(what, name, f"the loop at '{block.name}'", signals)
        sizes = {n: signals[n][0] for n in on}
        units = {n: signals[n][1] for n in on}
        new = block.output_sizes(sizes, units)
        outputs = {n: signals[n] for n in on} if new is None else new
        links.append(
            BlockLink(
                block, on, sum(sizes.values()), units[on[0]] if len(set(units.values())) == 1 else "", outputs
            )
        )
        if new is not None:
            unchanged = {n: k for n, k in signals.items() if n not in on}
            duplicates = [n for n in new if n in unchanged]
            if duplicates:
                raise ArgumentError(f"'{block.name}' defines '{duplicates[0]}' again: choose another name.")
            signals = {**unchanged, **new}
    return links, signals


def stack_named_signals(signals: Mapping[str, Any], names: Sequence[str]) -> Any:
    """Return the stacked SX column of named signals."""
    return ca.vertcat(*[signals[n] for n in names])


def replace_signals_by_block_outputs(
    signals: Mapping[str, Any], link: BlockLink, column: Any
) -> dict[str, Any]:
    result = dict(signals)
    if tuple(link.outputs) != link.on:
        result = {n: s for n, s in signals.items() if n not in link.on}
    first = 0
    for name, (size, _) in link.outputs.items():
        result[name] = column[first : first + size]
        first += size
    return result


def replace_waveforms_by_block_output(
    waves: Mapping[str, ActuatorWaveform], link: BlockLink, wave: ActuatorWaveform
) -> dict[str, ActuatorWaveform]:
    result = {n: w for n, w in waves.items() if n not in link.on}
    at = 0
    for name, (size, _) in link.outputs.items():
        result[name] = wave.apply_function_to_waveform(partial(slice_symbolic_rows, begin=at, end=at + size))
        at += size
    return result
