"""Every number that a verdict, a name, a flag or an interval of a diagnosis hangs on, in the order in which a diagnosis meets them.

Modules read them as `policy.NAME` when they need them, so a study or a test may set another value (`scripts/studies/policy.py` halves and
doubles each; docs/studies/policy.txt has the table). Below each stands what it decides, where its value comes from and how much it matters.
"By judgement" means that nothing but experience supports it.

Limits of effort stand in `effort.py`. Left where they are used: guards against rounding (`TINY`, `ROUNDING`), steps of differences, grids,
batches that fit the processor's cache, thresholds of what a reader is told, and what effects start from or estimate (`effects/`). How
readings are blocked is a matter of `readings/split.py`; half of the prior of a cause belongs to all its quantities together, half to some
of them (`mixture/listed.py`).
"""

from __future__ import annotations

import math

# Mistakes of the record

LARGEST_MEAN_SQUARE = 1.5
"""Mean square of the whitened residuals up to which no mistake of the record is looked for, where the noise is known. By judgement: three
standard deviations above 1 for 72 components, more for larger sessions. Study of 5 cases: no change."""

LEAST_LEFT_BY_MISTAKE = 0.05
"""Residual over field, both rms, from which on mistakes that begin in mid-session are looked for: they have hundreds of starts. Where more
is left by a record that was put right, and in the end something is unexplained, its mistakes are doubtful. Argument: an axis reversed for a
twenty-fifth of the readings leaves 0.2, and causes that are no mistakes leave a per cent. Study: none."""

LEAST_LOG_EVIDENCE_OF_MISTAKE = math.log(1e3) - math.log(1e-3)
"""Log evidence from which on a mistake is undone. Prior odds of 1 to 1000, for few sessions have one, and odds of 1000 to 1 after the
readings; both by judgement. Study of 1 case: no change."""

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

MOST_TRIMMED = 0.4
"""Share of the readings that may miss by far. Argument: of half, the others are not the majority that tells which are right.
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

# What is supposed before the readings are seen: how many things are wrong, of what kind, and how large they are

LISTED = 0.25
"""Probability that a slot holds a listed cause. By judgement: with six slots and the next rule, 0.12 of all sessions have nothing wrong.
Study of 5 cases: verdict or names change in 1, numbers change in 3."""

DEPARTURE = 0.05
"""Probability that a slot holds a departure, which no list holds. By judgement. Study of 5 cases: verdict or names change in 1, numbers
change in 2."""

WIDTHS = ((0.1, 0.15), (0.3, 0.25), (1.0, 0.4), (3.0, 0.13), (10.0, 0.07))
"""Factors on the stated width of a listed cause, and their probabilities. By judgement: most things are smaller than they may be, and some
are larger: a probe has elements 2 mm apart where 0.5 mm is stated. Study of 5 cases: verdict or names change in 1, numbers change in 4."""

AMPLITUDES = (0.5, 2.0, 8.0, 30.0)
"""Rms of a departure, or of a family of curves, in units of the noise, alike probable. Factors of four, so that any amplitude between 0.25
and 60 lies within a factor of two of one. Study of 5 cases: numbers change in 5."""

MISSTATED = 0.05
"""Probability that a noise is another which the rig file states as known. By judgement. Study: read by no case."""

MOST_MISSTATED = 4.0
"""Factor on such a noise, or its inverse. By judgement. Study: read by no case."""


def p_empty() -> float:
    """Probability that a slot holds nothing."""
    return 1.0 - LISTED - DEPARTURE


LOG_PRIOR_ODDS_LEFT = math.log(0.3 / 0.4)
"""Log prior odds of something that no cause explains against nothing; one of the causes is there with the same probability of 0.3. By
judgement. Study of 5 cases: no change."""


MOST_CAUSES = 6
"""Things that may be wrong at once, by default. Effort: each costs a draw a sweep; few sessions have more flaws that show. Study: not in
it."""

WIDER_PRIORS = (4.0, 16.0)
"""How many times wider than stated the prior of a number of the rig may truly be. By judgement: a factor of four apart, so that a number
4 to 60 widths off is expected by one of them. Study: not in it."""

# What is stated

STATED = 0.9
"""Probability from which on a cause is stated and told as sure, and from which scatter, or a number far from its prior, is unexplained.
Convention. Study of 4 cases: no change."""

ALTERNATIVE = 0.05
"""Share of a set from which on something is an alternative to what is there; a credible set holds the rest. Convention. Study of 4 cases:
verdict or names change in 2."""

OUTWEIGHS = 2.0
"""Times the evidence of what is left that a cause must have to be stated where all slots are full. By judgement. Study: read by no case."""

LIKED_BY = 10.0
"""Log density by which linear models err: an expansion that has all leading causes is preferred by as much. By measurement in hidden
sessions. Study of 5 cases: no change."""

IMITATION = (4.0, -0.85, -0.35, 1.9, -1.45, -3.6)
"""Weights of the `features` of a name (`mixture/imitation.py`) in its log odds against something that no list holds. Counted by `make study
NAME=imitations`. Study of 4 cases: numbers change in 2."""

RELATIVE_WIDTH = 0.5
"""Prior standard deviation of how much stronger the change by a relative is, a standard deviation of a circumstance away. By judgement.
Study of 4 cases: numbers change in 1."""

NEGLIGIBLE_SHARE = 0.01
"""Share of the misfit of unseen readings below which a clear cause is told without a name: it may be any of many things. By judgement.
Study of 1 case: no change."""

MOST_TAKEN = 1.1
"""Factor by which the predicted field may miss unseen readings more with corrections than without. By judgement: a tenth shows in a few
hundred readings. One magnet of known field, which missed a third more, was predicted 13 uT off with corrections and 5 without; in 16 mixed
sessions the factor did not tell whether they helped, and the only one above 1.1 was better with them. Study of 1 case: numbers change in
1."""

MOST_BESIDE_A_NAME = 0.2
"""Probability that a cause is something else, which no list holds, up to which its name may be stated alone; beyond, that belongs to its
credible set. By measurement (docs/decisions/0084). Study: not in it."""

# Verdict

VALIDATION_SHARE = 0.2
"""Share of the readings that are kept out of all fits, in blocks of places, to judge them. Convention. Study: read by no case."""

LEAST_LOSS_SE = 3.0
"""Standard errors from which on a loss in log predictive density turns the verdict into `unexplained`. Statistics: 0.1 % by chance, for a
verdict hangs on it. Study of 5 cases: no change."""

# What the session can reveal, and next readings

VISIBLE_SIGMA = 5.0
"""Standard deviations by which a cause must change the readings, beyond what the fit follows, to be called visible. Convention; about the
size at which the evidence for a cause suffices in the linear model. Study of 5 cases: numbers change in 5."""

# Symptoms and report

CLEAR_LOG_EVIDENCE = math.log(20.0)
"""Log evidence by which one answer must lead to be told without the other: causes, mistakes, instants; a cause must exceed nothing to be
designed for at its fitted size, and a programme must add to be proposed. A mistake of the record that loses as much on a few readings is
not fitted to all. Statistics: odds of 20 to 1. Study of 6 cases: numbers change in 1."""
