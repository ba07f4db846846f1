"""What the page of the service shows of a diagnosis, as numbers in SI: the content of `panels.json`."""

from __future__ import annotations

from dataclasses import dataclass

Vectors = list[list[float]]


@dataclass(frozen=True)
class Shown:
    """A number of the rig as people read it: values times `factor` are in `unit`."""

    name: str
    words: str
    unit: str
    factor: float


@dataclass(frozen=True)
class Answer:
    """One thing that is wrong.

    Attributes:
        label: Name of the cause, with its place where the rig has several for it.
        place: What it belongs to.
        kind: Whether that is a coil, a sensor, a mover, the room or the record.
        words: What it is, in words.
        probability: Posterior probability.
        sizes: Its quantities with their 90 % intervals, in words.
        alternatives: What it cannot be told from, with probabilities.
    """

    label: str
    place: str
    kind: str
    words: str
    probability: float
    sizes: list[str]
    alternatives: list[tuple[str, float]]


@dataclass(frozen=True)
class WindingOutline:
    """A winding in its coil's frame, from its front face at z = 0 backwards, in m."""

    inner_radius_m: float
    outer_radius_m: float
    length_m: float


@dataclass(frozen=True)
class ResidualMap:
    """Residuals where one coil carried current, in its frame.

    Attributes:
        coil: Name of the coil.
        winding: Its outline; None for a coil without a winding.
        position_m: Places of the sensor.
        before_T, after_T: Measured less predicted field by the rig as described and as extended.
        patterns_T: Field that hypotheses add to the prediction, by label.
    """

    coil: str
    winding: WindingOutline | None
    position_m: Vectors
    before_T: Vectors
    after_T: Vectors
    patterns_T: dict[str, Vectors]


@dataclass(frozen=True)
class Runner:
    """One hypothesis of a race.

    Attributes:
        label: The cause; `nothing`, or `unexplained` for a departure that no list holds.
        words: What it is.
        log_bayes_factor: Against nothing wrong.
        role: `named`, `alternative` to what was named, `stand-in` or `other`.
        left_sigma: Root mean square of what it leaves, in units of the noise; None where it was not fitted in full.
    """

    label: str
    words: str
    log_bayes_factor: float
    role: str
    left_sigma: float | None


@dataclass(frozen=True)
class Race:
    """The hypotheses of one step of the search, best first; `taken` is empty where none had enough evidence."""

    taken: str
    runners: list[Runner]


@dataclass(frozen=True)
class Moved:
    """One number of the rig before and after the extension, and what each cause does to it.

    Attributes:
        shown: How it is told.
        before, after: Value and standard deviation, in SI.
        moved_sd: Distance between them, in standard deviations of the first.
        pulls_sd: Shift in standard deviations if one cause were left out, by label.
    """

    shown: Shown
    before: tuple[float, float]
    after: tuple[float, float]
    moved_sd: float
    pulls_sd: dict[str, float]


@dataclass(frozen=True)
class NextMeasurement:
    """Readings to take next.

    Attributes:
        words: What to measure.
        why: What for.
        by_hand: What has to be changed by hand first; empty where nothing is.
        plan: Text of a plan file.
        n_stops: Its length.
    """

    words: str
    why: str
    by_hand: str
    plan: str
    n_stops: int


@dataclass(frozen=True)
class Panels:
    """All panels of one diagnosis.

    Attributes:
        rig: Name of the rig.
        source: Where the readings come from.
        verdict: As in `diagnosis.json`.
        headline, warnings: The sentences of the report.
        answers: What is wrong, one by one.
        n_readings: Readings that were searched.
        noise_T: Median noise of a component.
        left_sigma: Root mean square of the residual before and after, in units of the noise.
        maps: Residuals around each coil that carried current.
        races: Hypotheses, step by step.
        moved: Numbers of the rig before and after.
        moved_words: What the extension does to them, in a sentence or two; empty where nothing was found.
        next: Proposed next readings, best first.
    """

    rig: str
    source: str
    verdict: str
    headline: list[str]
    warnings: list[str]
    answers: list[Answer]
    n_readings: int
    noise_T: float
    left_sigma: tuple[float, float]
    maps: list[ResidualMap]
    races: list[Race]
    moved: list[Moved]
    moved_words: str
    next: list[NextMeasurement]
