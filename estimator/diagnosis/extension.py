"""The rig with the causes that were found, as a rig file."""

from __future__ import annotations

import math

import yaml

from estimator.diagnosis.fitting import Fit
from estimator.rig.parameters import LogNormal, Normal, Parameter, Prior, Uniform
from estimator.rig.rig import Rig
from estimator.yaml_section import Section

NOTE = "# Found by coilcal diagnose; null is 0 unless said otherwise."


def extended_text(rig: Rig, fit: Fit) -> str:
    """The rig's YAML with the effects of a fit: those of the file as they were written, new ones with values at the maximum."""
    base, written = _without_effects(rig.text)
    entries: dict[str, object] = {}
    for cause in fit.rig.effects:
        prefix = f"{cause.label}."
        entries[cause.label] = written.get(cause.label) or {
            name[len(prefix) :]: _entry(parameter, float(fit.values[name]))
            for name, parameter in fit.rig.parameters.items()
            if name.startswith(prefix)
        }
    if not entries:
        return base
    block = yaml.safe_dump({"effects": entries}, sort_keys=False, default_flow_style=None, width=130)
    return f"{base}\n{NOTE}\n{block}"


def _without_effects(text: str) -> tuple[str, dict[str, object]]:
    """A rig file without its effects, and what it says of them."""
    lines = [line for line in text.splitlines() if line != NOTE]
    top = yaml.compose("\n".join(lines))
    written = Section.from_text("\n".join(lines), "rig").value("effects") or {}
    nodes = top.value if isinstance(top, yaml.MappingNode) else []
    for key, value in nodes:
        if key.value == "effects":
            end = value.end_mark.line + (value.end_mark.column > 0)
            lines[key.start_mark.line : end] = []
    return "\n".join(lines).rstrip() + "\n", written


def _entry(parameter: Parameter, value: float) -> object:
    """One number in the notation of rig files, in SI."""
    if parameter.prior is None:
        return value
    return {"value": value, "prior": _prior(parameter.prior)}


def _prior(prior: Prior) -> dict[str, dict[str, float]]:
    bounds = {key: end for key, end in (("lower", prior.lower), ("upper", prior.upper)) if math.isfinite(end)}
    if isinstance(prior, Normal):
        return {"normal": {"mean": prior.mean, "sd": prior.standard_deviation, **bounds}}
    if isinstance(prior, LogNormal):
        return {"log_normal": {"median": prior.median, "relative_sd": prior.relative_sd, **bounds}}
    assert isinstance(prior, Uniform)
    return {"uniform": bounds}
