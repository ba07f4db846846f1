"""Every rule with a number that steers a recalibration, beside those of `estimator/diagnosis/policy.py`, which it shares.

Modules read them as `policy.NAME` when they need them, so a study or a test may set another value (`scripts/studies/policy.py` halves and
doubles each; docs/studies/policy.txt has the table). Below each stands what it decides, where its value comes from and how much it matters.

Readings tested and fitted, the share kept out, and the odds for a cause are those of the diagnosis. Left where they are used: guards
against rounding, simulated sessions in one batch, and what a page has room for.
"""

from __future__ import annotations

# Agreement with the current version

FALSE_ALARMS = 1e-3
"""p-value below which a session disagrees, and below which a residual is larger than noise. Statistics: one false alarm in twenty years of
weekly sessions; the rate was measured (docs/results.md). Study of 3 cases: no change."""

N_DRAWS = 400
"""Draws of a posterior that stand for it. Statistics: variances are known to 7 %; more cost a prediction each. Study of 3 cases: numbers
change in 3."""

N_SIMULATED = 20_000
"""Simulated sessions that a p-value is counted among. Statistics: twenty of them lie below the rate of false alarms, so it is known to 22
%. Study of 3 cases: numbers change in 3."""

# The old posterior as a widened prior

EXPANSION = 3e-4
"""Relative standard deviation of what the lengths of a winding may have changed. Physics: copper by 20 K (1.7e-5 per kelvin). Study of 3
cases: numbers change in 3."""

LOOPS = 0.01
"""Standard deviation of what the number of loops may have changed. Physics: a winding keeps its loops; its leads are part of one. Study of
3 cases: no change."""

SHARE_OF_AGEING = 0.1
"""Standard deviation of what may have changed in a sensor or a supply between two sessions, over the width of its first prior. By judgement
(docs/decisions/0014). Study of 3 cases: numbers change in 3."""

# The job

SETTLED_S = 60.0
"""Seconds since the last change of a session that cannot be read, from which on it is damaged and not being copied. By judgement. Study:
not in it."""

ALERT_TIMEOUT_S = 30.0
"""Seconds that an alert's command or webhook may take. By judgement: an alert must not hold up the job. Study: not in it."""
