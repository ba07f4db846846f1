"""The rig with the causes that were found, as a rig file."""

from __future__ import annotations

import re

import yaml

from estimator.diagnosis.fitting import Fit
from estimator.parameters import LogNormal, Normal, Parameter, Prior, Uniform
from estimator.rig import Rig

EFFECTS_BLOCK = re.compile(r"^effects:.*?(?=^\S|\Z)", re.MULTILINE | re.DOTALL)


def extended_text(rig: Rig, fit: Fit) -> str:
    """The rig's YAML with the effects of a fit: values at its maximum, priors as declared with the causes."""
    base = EFFECTS_BLOCK.sub("", rig.text).rstrip() + "\n"
    if not fit.rig.effects:
        return base
    entries: dict[str, dict[str, object]] = {}
    for cause in fit.rig.effects:
        prefix = f"{cause.label}."
        entries[cause.label] = {
            name[len(prefix) :]: _entry(parameter, float(fit.values[name]))
            for name, parameter in fit.rig.parameters.items()
            if name.startswith(prefix)
        }
    block = yaml.safe_dump({"effects": entries}, sort_keys=False, default_flow_style=None, width=130)
    return f"{base}\n# Found by coilcal diagnose; null is 0 unless said otherwise.\n{block}"


def _entry(parameter: Parameter, value: float) -> object:
    """One number in the notation of rig files, in SI."""
    if parameter.prior is None:
        return value
    return {"value": value, "prior": _prior(parameter.prior)}


def _prior(prior: Prior) -> dict[str, dict[str, float]]:
    if isinstance(prior, Normal):
        return {"normal": {"mean": prior.mean, "sd": prior.standard_deviation}}
    if isinstance(prior, LogNormal):
        return {"log_normal": {"median": prior.median, "relative_sd": prior.relative_sd}}
    assert isinstance(prior, Uniform)
    return {"uniform": {"lower": prior.lower, "upper": prior.upper}}
