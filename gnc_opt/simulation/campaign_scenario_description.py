"""Description of a campaign's scenario in words: parts of the closed loop, controller design, dispersions, versions."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass
from typing import Any

import numpy as np

from gnc_opt.model.model_variables import Layout
from gnc_opt.simulation.closed_loop import ClosedLoop
from gnc_opt.simulation.dispersions import RandomRotation
from gnc_opt.text_html_and_json_formatting import pluralise_noun
from gnc_opt.threads_and_package_versions import list_software_versions

_TIMES = dict.fromkeys(("period", "minimum_on"), "s")
"""Units of values that are no parameters of the loop."""

_SPREADS = ("std", "mean", "low", "high", "radius", "angle", "values")
"""Values of dispersions in the unit of the dispersed quantity."""


_WORDS = {"sigma": "standard deviation", "std": "standard deviation", "tau": "time constant"}
"""Words for fields that are named by a symbol or an abbreviation; "sigma" may also be the name of an attitude."""


def describe_campaign_scenario(
    loop: ClosedLoop, parameters: Layout, dispersions: Mapping[str, Any]
) -> tuple[tuple[str, str, str], ...]:
    """Return kind, name and description of parts of a loop, dispersions, results of its design and versions."""
    plant, control = loop.plant, loop.controller
    sizes = f"{pluralise_noun(plant.states.size, 'state')}, {pluralise_noun(plant.controls.size, 'control')}"
    rows = [("plant", plant.name, sizes), ("controller", control.name, f"control step {loop.dt:g} s")]
    for kind in ("sensors", "actuators", "disturbances", "events"):
        for part in getattr(loop, kind):
            part_parameters = (v for v in parameters.variables if v.name.startswith(f"{part.name}."))
            units = _TIMES | {v.name.partition(".")[2]: v.unit for v in part_parameters}
            rows.append((kind.removesuffix("s"), part.name, _describe_scenario_element(part, units)))
    if loop.replanner is not None:
        rows.append(("re-planning", "", f"every {loop.replanner.every:g} s"))
    for name, part in dispersions.items():
        relative = getattr(part, "relative", None)
        unit = "rad" if isinstance(part, RandomRotation) else "" if relative else parameters[name].unit
        how = {None: "", True: " to the nominal value", False: ", added to the nominal value"}[relative]
        rows.append(
            ("dispersion", name, _describe_scenario_element(part, dict.fromkeys(_SPREADS, unit)) + how)
        )
    for name, value, unit, remark in control.explain().rows:
        text = f"{value} {unit}".rstrip() + f" ({remark})" * bool(remark)
        rows.append(("design", name, text))
    return (*rows, *(("software", *pair) for pair in list_software_versions().items()))


def _describe_scenario_element(part: Any, units: Mapping[str, str]) -> str:
    """Return "noise on q: standard deviation 0.05 m": class, place and the values that differ from its defaults."""
    kind = re.sub(r"(?<!^)([A-Z])", r" \1", type(part).__name__).lower()
    signals = np.ravel(getattr(part, "on", None) or []).tolist()
    kind += f" on {', '.join(map(str, signals))}" * bool(signals)
    values = ", ".join(_describe_non_default_settings(part, units)) if is_dataclass(part) else ""
    return f"{kind}: {values}" if values else kind


def _describe_non_default_settings(part: Any, units: Mapping[str, str]) -> Iterator[str]:
    members = sorted(
        fields(part), key=lambda member: member.name == "relative"
    )  # last, before the words on it
    for member in members:
        name, value = member.name, getattr(part, member.name)
        if name in ("name", "on") or (member.default is not MISSING and value is member.default):
            continue
        if isinstance(value, bool):
            yield name if value else f"not {name}"
        elif is_dataclass(value):
            yield f"{name} {_describe_scenario_element(value, units)}"
        elif isinstance(value, (int, float, str, list, tuple, np.ndarray)):  # no functions or expressions
            texts = [f"{v:.4g}" if isinstance(v, float) else str(v) for v in np.ravel(value).tolist()]
            numbers = texts[0] if len(set(texts)) == 1 else ", ".join(texts)
            yield f"{_WORDS.get(name, name.replace('_', ' '))} {numbers} {units.get(name, '')}".rstrip()
