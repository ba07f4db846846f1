"""Limits of effort, which more time would not need: modules read them as `effort.NAME`."""

from __future__ import annotations

# Draws of the prior that a first fit starts from, beside the nominal values: each costs one more fit
MORE_STARTS = 3
# Readings that causes are searched with, and that a recalibration tests for agreement
MOST_READINGS_SEARCHED = 512
# Readings of the final fits and of those that judge them: intervals shrink with the root of their number
MOST_READINGS_FITTED = 3000
# Gain in log density below which the last fit of a model stops: far below any difference that decides
FINE_TOLERANCE = 1e-4
# The same of a fit that is one of many: log evidences that decide differ by more than 1
ROUGH_TOLERANCE = 1e-2
# How near its maximum such a fit of more than 22 numbers ends: rms over them, in standard deviations
ROUGH_TO_SD = 0.03
# The same of the fits of a corrected model: no name depends on them, and hundreds of amplitudes crawl along valleys
CORRECTED_TO_SD = 0.08
MOST_READINGS_COMPARED = 100  # readings on which all starts of all mistakes of the record are compared
MOST_MISTAKES_FITTED = 6  # mistakes that are fitted after that comparison, the best of them first
