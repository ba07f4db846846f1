"""The rig extended by the causes that were found: the rig that is sampled, and the content of `rig_extended.yaml`."""

from __future__ import annotations

from dataclasses import replace

from estimator.diagnosis.fitting import Fit
from estimator.rig.parameters import Parameter
from estimator.rig.rig import Rig

NOTE = (
    "Extended by coilcal diagnose, in SI: under effects is what was found, under corrections what has no name. "
    "Null is 0 unless said otherwise."
)


def extended_rig(rig: Rig, fit: Fit) -> Rig:
    """The rig with the effects and corrections of a fit. Those that it had stay as described; new ones get the values at the maximum.

    Args:
        rig: As described; its numbers keep their nominal values.
        fit: Of that rig with further effects or corrections.
    """
    extended = rig
    for cause in rig.acting:
        extended = extended.without_cause(cause)
    for cause in fit.rig.acting:
        is_new = cause not in rig.acting
        source = fit.rig if is_new else rig
        parameters = [source.parameters[name] for name in source.names_of(cause).values()]
        add = extended.with_correction if cause in fit.rig.corrections else extended.with_cause
        extended = add(cause, [_at_maximum(p, fit) if is_new else p for p in parameters])
    return extended


def _at_maximum(parameter: Parameter, fit: Fit) -> Parameter:
    """A parameter with the fitted value as its nominal one, clamped: rounding may put it a last digit beyond a bound of the prior."""
    value, prior = float(fit.values[parameter.name]), parameter.prior
    return replace(parameter, value=value if prior is None else min(max(value, prior.lower), prior.upper))
