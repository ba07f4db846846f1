"""Every rule with a number by which a calibration is judged: what it decides and where its value comes from."""

from __future__ import annotations

TENSION_SD = 2.5
"""Distance of a fitted number from the middle of its prior, in the prior's standard deviations, from which on the report lists it.
Statistics: with ten parameters and right priors, one session in ten lists one."""

MISSED_SHARE = 0.2
"""Error over the field from which on a calibration is unusable. By judgement: wrong signs, units and frames leave more, and a model that
misses a fifth of the field predicts nothing."""

MISSED_NOISE = 3.0
"""Error over what the expected noise leaves up to which no calibration is unusable: weak fields drown in noise without any fault."""

LARGER_THAN_NOISE = 1.5
"""Error over what the expected noise leaves from which on something is suspect. Statistics: six standard deviations for twenty readings."""

LEAST_AGREEMENT = 2e-3
"""Probability by noise alone, counted over all halves of a session, below which their disagreement is suspect. Statistics: one right
model in 500 is suspected."""

FAR_SD = 3.5
"""Distance of a fitted number from the middle of its prior, up or down, in the prior's standard deviations, that is suspect; a diagnosis
then looks for a mistake of the record. Statistics: 0.05 % of right priors, since there are a dozen of them."""

LEAST_COVERAGE90 = 0.75
"""Share of the components of unseen readings inside their 90 % intervals below which these are suspect, if chance alone leaves so few
with a probability below `LEAST_AGREEMENT`. Statistics: four standard deviations for twenty readings of three components."""
