"""Every rule with a number that steers a diagnosis, in the order in which a diagnosis meets them.

Modules read them as `policy.NAME` when they need them, so a study or a test may set another value (`scripts/studies/policy.py` halves and
doubles each; docs/studies/policy.txt has the table). Below each stands what it decides, where its value comes from and how much it matters.
"By judgement" means that nothing but experience supports it.

Left where they are used: guards against rounding (`TINY`, `ROUNDING`, `RANK_TOLERANCE`), steps of differences, grids, batches that fit the
processor's cache, what a page has room for, and what effects start from or estimate (`effects/`). How readings are blocked is a matter of
`readings/split.py`; half of the prior of a cause belongs to all its quantities together, half to some of them (`hypotheses/screening.py`).
"""

from __future__ import annotations

import math

# Fits and effort

MORE_STARTS = 3
"""Draws of the prior that a first fit starts from, beside the nominal values. Effort: each costs one more fit; fits of later hypotheses
start from the maximum that was found. Study of 6 cases: numbers change in 2."""

MOST_READINGS_SEARCHED = 512
"""Readings that causes are searched with, and that a recalibration tests for agreement. Effort: the time of a search grows with them; what
a wrong model leaves does not average out over more. Study: read by no case."""

MOST_READINGS_FITTED = 3000
"""Readings of the final fits and of those that judge them. Effort: standard deviations fall with the root of their number, and a fit of
3000 takes seconds. Study of 5 cases: no change."""

FINE_TOLERANCE = 1e-4
"""Gain in log density below which the last fit of a model stops. Effort: far below any difference that decides. Study of 6 cases: numbers
change in 4."""

ROUGH_TOLERANCE = 1e-2
"""Gain in log density below which a fit stops that is one of many. Effort: log evidences that decide differ by more than 1. Study of 5
cases: numbers change in 2."""

ROUGH_TO_SD = 0.03
"""How near its maximum such a fit ends where it has more than 22 numbers: root mean square over them, in standard deviations. Effort:
hundreds of numbers crawl along valleys. Study: not in it, for its models are smaller."""

CORRECTED_TO_SD = 0.08
"""How near its maximum the fit of a corrected model to all readings that count ends, and the one before it to those of the search: root
mean square over its numbers, in standard deviations. Effort: no name depends on it, and hundreds of amplitudes crawl. Study: not in it."""

NEAR_BOUND = 1e-3
"""Distance from a bound of the prior, in its standard deviations, at which the density may still rise beyond: the last Newton step leaves
such a coordinate alone. By judgement. Study of 5 cases: no change."""

MOST_NOISE_SHRINK = -5.0
"""Logarithm of the smallest noise that more columns may lead to, over the fitted one. By judgement: a factor of 150, beyond which digits of
the readings or the prior of the noise rule first. Study of 5 cases: numbers change in 5."""

# Mistakes of the record

LARGEST_MEAN_SQUARE = 1.5
"""Mean square of the whitened residuals up to which no mistake of the record is looked for, where the noise is known. By judgement: three
standard deviations above 1 for 72 components, more for larger sessions. Study of 5 cases: no change."""

MOST_STARTS_OF_FAINT = 2
"""Ways in which a mistake of the record can be made, up to which it is looked for even where all is as expected: where fields are weak,
those in another frame make nothing absurd. Effort: one linear step each. Study: not in it."""

LEAST_LEFT_BY_MISTAKE = 0.05
"""Residual over field, both rms, from which on mistakes that begin in mid-session are looked for: they have hundreds of starts. Where more
is left by a record that was put right, and in the end something is unexplained, its mistakes are doubtful. Argument: an axis reversed for a
twenty-fifth of the readings leaves 0.2, and causes that are no mistakes leave a per cent. Study: none."""

MOST_READINGS_COMPARED = 100
"""Readings on which all starts of all mistakes are compared, and the best of them fitted first. Effort: mistakes make most readings absurd
. Study of 1 case: no change."""

MOST_MISTAKES_FITTED = 6
"""Mistakes that are fitted after that comparison. Effort. Study of 1 case: no change."""

LEAST_LOG_EVIDENCE_OF_MISTAKE = math.log(1e3) - math.log(1e-3)
"""Log evidence from which on a mistake is undone. Prior odds of 1 to 1000, for few sessions have one, and odds of 1000 to 1 after the
readings; both by judgement. Study of 1 case: no change."""

MOST_MISTAKES = 3
"""Mistakes that are undone one after another. Effort: three in one session are rare. Study of 5 cases: no change."""

# Single readings that were recorded otherwise than they were measured

FAR_FROM_EXPECTED = 12.0
"""Size of an error, in standard deviations of the errors of most readings, from which on a reading misses by far. By judgement: normal
errors never do, and few readings miss so far where the model is wrong. Study: not in it."""

NEAR_TO_EXPECTED = 5.0
"""Size of an error, in the same, up to which a reading is as a mistake would have it. By judgement: of ten thousand normal errors none is
larger; the fit of the others is a little off. Study: not in it."""

LEAST_OF_A_SIGN = 0.1
"""Share of a coil's clear readings that must have either sign where none was recorded, and the most of them that may agree with neither. By
judgement: fewer are mistakes of single rows. Study: not in it."""

FIELD_BUT_FOR_ITS_SIGN = 0.5
"""Error of a reading, over the field of the coils, up to which it agrees with that but for its sign. By judgement: rigs are described to
some per cent and millimetres, and other mistakes change directions. Study: not in it."""

MOST_TRIMMINGS = 5
"""Fits to the readings that do not miss by far, one after another. Effort: one fit each; most settle after three. Study: not in it."""

MOST_TRIMMED = 0.4
"""Share of the readings that may miss by far. Argument: of half, the others are not the majority that tells which are right.
Study: not in it."""

TRIMMINGS_TO_A_SHARE = 2
"""The first of those fits, to the rest that misses least whatever it misses by. By measurement: a fit to all readings, a quarter of them
ten times too large, leaves none near. Study: not in it."""

MOST_ROUNDS_OF_FLAGS = 3
"""How often such readings are looked for, each time without those found before. Effort: a fit each; a finer fit shows finer mistakes.
Study: not in it."""

MUCH_MORE_PROBABLE = 100.0
"""How many times more probable a mistake must be than a wrong model and than a wild value, in each stretch of rows and in all that it
explains. By judgement. Study: not in it."""

DEGREES_OF_ERRORS = 3.0
"""Degrees of freedom of Student's t, which errors of a wrong model follow beside those of the neighbours. By judgement: few enough that one
in a thousand misses by twelve standard deviations. Study: not in it."""

BETTER_BY = 1.0
"""Standard deviations by which a mistake must fit a reading better than none, where it was clearly made in others beside it. By
measurement: with 0 three right rows of one session were flagged whose place hardly changes by the mistake. Study: not in it."""

FEWEST_OF_ONE_MISTAKE = 3
"""Readings in which a mistake must show clearly before others are believed to have it that it changes little. By judgement. Study:
not in it."""

# Prior probabilities of the hypotheses

LOG_PRIOR_ODDS_LEFT = math.log(0.3 / 0.4)
"""Log prior odds of something that no cause explains against nothing; one of the causes is there with the same probability of 0.3. By
judgement. Study of 5 cases: no change."""

# Screening

LEAST_SCATTER_GAIN = 4.0
"""Log likelihood that outliers or a scattering mover must gain at the residuals as they are to enter the race. Effort: to be taken a cause
needs a log evidence of 7 or so. Study of 5 cases: no change."""

# Search

CREDIBLE_SHARE = 0.95
"""Probability that a credible set of causes holds. Convention; 24 of 25 sets held the truth (docs/results.md). Study of 5 cases:
verdict or names change in 1."""

MOST_CAUSES = 6
"""Things that may be wrong at once, by default. Effort: each costs a draw a sweep; few sessions have more flaws that show. Study: not in
it."""

# Flexible curves, for what no cause explains

AMPLITUDES = (0.5, 2.0, 8.0, 30.0)
"""Rms of a family of curves, in units of the noise, over which its evidence is averaged. Factors of four, so that any amplitude between
0.25 and 60 lies within a factor of two of one. Study of 5 cases: numbers change in 5."""

HARMONIC_DEGREE = 5
"""Degree of the fields that sources outside the workspace make. By judgement: they fall with the power of the distance. Study of 5 cases:
numbers change in 3."""

TIME_DEGREE = 6
"""Degree of the polynomials in time. By judgement: three periods of what swings during a session. Study of 5 cases: numbers change in 5."""

SETTING_DEGREE = 4
"""Degree of the curves in one circumstance, such as a current or a pause. By judgement: smooth curves with few turns. Study of 5
cases: numbers change in 4."""

N_INSTANTS_OF_BURSTS = 24
"""Parts of a session between which readings may scatter more, any number of them in a row. By judgement: a burst of four readings among 96
is one of them. Study: not in it."""

SCATTER_AMPLITUDES = (0.3, 1.0)
"""How far the size of misses depends on something, in standard deviations of their normal scores. By judgement: less
is hardly visible in a hundred readings, and more is not possible for long. Study: not in it."""

WIDER_PRIORS = (4.0, 16.0)
"""How many times wider than stated the prior of a number of the rig may truly be. By judgement: a factor of four apart, so that a number
4 to 60 widths off is expected by one of them. Study: not in it."""

# What is in no list

MOST_BESIDE_A_NAME = 0.2
"""Probability that a cause is something else, which no list holds, up to which its name may be stated alone; beyond, that belongs to its
credible set. By measurement (docs/decisions/0084). Study: not in it."""

# Verdict

LEAST_LOG_ODDS_LEFT = math.log(10.0)
"""Posterior odds against nothing from which on what is left counts as unexplained. By measurement: in clean sessions of the tuning seeds
the log evidence scatters by 1 about -3 and never reached 2. Study of 5 cases: no change."""

VALIDATION_SHARE = 0.2
"""Share of the readings that are kept out of all fits, in blocks of places, to judge them. Convention. Study: read by no case."""

LEAST_IMPROVEMENT_SE = 2.0
"""Standard errors from which on a rise of the log predictive density is significant: the report says so, and a recalibration may replace a
version. Statistics: 2 % by chance. Study: read by no case."""

LEAST_LOSS_SE = 3.0
"""Standard errors from which on a loss in log predictive density turns the verdict into `unexplained`. Statistics: 0.1 % by chance, for a
verdict hangs on it. Study of 5 cases: no change."""

# Corrections

# Widening of intervals

LEAST_SHARE_JUDGED = 1e-3
"""Share of a block's own scatter, in one direction, from which on the other blocks say where the parameters would go without it. By
judgement: below, that block alone determines the direction, and one over the share blows up its noise. Study of 1 case: no change."""

# What the session can reveal, and next readings

VISIBLE_SIGMA = 5.0
"""Standard deviations by which a cause must change the readings, beyond what the fit follows, to be called visible. Convention; about the
size at which the evidence for a cause suffices in the linear model. Study of 5 cases: numbers change in 5."""

MUCH_ABSORBED = 0.5
"""Share of what a cause changes, in squares, that free numbers of the rig must follow for the report to say which do. For a reader. Study:
not in it."""

PLAUSIBLE_SD = 3.0
"""Standard deviations of its prior up to which a size of a cause is plausible. Statistics: 0.3 % lie beyond. Study of 6 cases: numbers
change in 5."""

LEAST_SURE_OF_NOTHING = 0.2
"""Probability that nothing is wrong below which `nothing_found` says what is more probable, though nothing is sure enough to be named. By
judgement: a cause needs odds of 20 to 1 alone, several together may reach 4 to 1 before. Study: not in it, for it changes words only."""

TYPICAL_SIGMA = 8.0
"""Visible size at which causes are compared that the session does not show. Convention: that of the hidden study. Study of 6 cases: numbers
change in 6."""

LEAST_DIRECTION = 1e-3
"""Singular value, over the largest, of a direction in which the columns of a cause count. By judgement. Study of 5 cases: no change."""

N_STOPS = 30
"""Readings that a proposed programme adds. By judgement: few enough to be taken at once. Study of 2 cases: numbers change in 1."""

MOST_PROPOSALS = 8
"""Programmes that are listed for each credible set. For a reader. Study of 1 case: no change."""

CURRENT_SHARES = (1.0, -1.0, 0.5, 0.0)
"""Currents at which stops are considered, over the largest of the session. What tells odd, even and cubic from no dependence. Study of 1
case: numbers change in 1."""

MOST_POSES = 150
"""Poses at which stops are considered. Effort: choosing each stop tries all. Study of 1 case: no change."""

MAP_PLACES_ALONG_AXIS = 7
"""Places of a map that are considered along each axis of a ball. By judgement: a field of fifth degree turns five times. Study: not in
it."""

NEARLY_NOTHING = 0.1
"""Visible size of a cause as large as its prior's width, in standard deviations, below which a design refuses it. By judgement. Study of 1
case: no change."""

# Symptoms and report

CLEAR_LOG_EVIDENCE = math.log(20.0)
"""Log evidence by which one answer must lead to be told without the other: causes, mistakes, instants; a cause must exceed nothing to be
designed for at its fitted size, and a programme must add to be proposed. A mistake of the record that loses as much on a few readings is
not fitted to all. Statistics: odds of 20 to 1. Study of 6 cases: numbers change in 1."""

SIGNATURE_DEGREES = (1, 2, 3)
"""Degrees of the polynomials that describe what a residual stays with. By judgement: several, so that none pays for columns it does not
need. Study of 5 cases: numbers change in 5."""

N_NOISE_DRAWS = 2000
"""Draws of pure noise that these tests are compared with. Statistics: a p-value of 0.05 is known to 10 %. Study of 5 cases: numbers change
in 5."""

SAME_ORDER = 0.999
"""Correlation of time and order beyond which order says nothing that time does not. By judgement. Study of 5 cases: no change."""

FEWEST_REPEATS = 10
"""Degrees of freedom of repeats from which on they, not the rig file, say what the noise is. Statistics: it is then known to 22 %. Study of
5 cases: no change."""

SIGNIFICANT = 0.05
"""p-value below which the report speaks of structure, or of more than noise may leave. Convention; no verdict depends on it. Study: not
in it."""

CLEARLY_MORE = 1.2
"""Residual over noise from which on the report says more, though the noise may be so. For a reader. Study: not in it."""

CLEAR_SD = 2.0
"""Standard deviations from zero from which on a number of a cause is told in the first sentence, and by which a cause of a usual size could
move a number of the rig unseen for `nothing_found` to tell it. For a reader. Study: not in it."""

CLEARLY_LARGER = 1.5
"""Factor between two numbers of standard deviations, or two standard deviations, from which on the difference is told: the difference of
two quantities must be so much farther from zero than either of them to be told beside them, and an interval so much wider for its number
to count as no longer determined. For a reader. Study: not in it."""

MOVED_SD = 1.0
"""Standard deviations that a number of the rig must move to be listed as moved. For a reader. Study: not in it."""

LISTED_IMPACT_SD = 0.3
"""Standard deviations that a cause must move a number of the rig for its impact to be listed. For a reader. Study: not in it."""

MISCOVERED_SE = 3.0
"""Standard errors of a share, of as many as there are unseen readings, by which 90 % intervals hold too few of their components, or too
many, to be said. Statistics: one right model in 700 is told to be too sure, if the components of a reading share their error. Study: not in
it."""

MOST_COVERAGE90 = 0.97
"""Share of unseen components in 90 % intervals above which the report warns that they are too wide, unless chance gives as many. By
judgement. Study: not in it."""

LEAST_MISFIT_TOLD = 0.1
"""Squared error of the rig as described beyond the noise, over that of the noise, from which on an error budget is told. By judgement:
below, shares are of chance. Study: not in it."""
