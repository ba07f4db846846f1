"""What is true of a session: numbers, what is wrong in it, and which of its rows were recorded otherwise than they were measured."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from tests.hidden.flaw import Stage, record
from tests.hidden.handed_in import HiddenSession
from tests.hidden.study import is_relative, label, true_quantities

SHARP_SIGMA, SMOOTH_SIGMA = 1.0, 0.05  # what a wrong row is off at least; what a right one may be off
MOST_SHARE = 0.5  # of the rows that are wrong by a mistake
EVERYWHERE = {
    "background_field",
    "sensor_offset",
}  # no laboratory is without them, so a calibration fits them


@dataclass(frozen=True)
class TrueCause:
    """One cause that is hidden in a session.

    Attributes:
        name: As coilcal would call it.
        is_known: Whether its library has it.
        sigma: Visible size after all else was adjusted; None where the cause has none.
        quantities: Sizes by the keys of `diagnosis.json`, where they have counterparts.
    """

    name: str
    place: str
    is_known: bool
    sigma: float | None
    quantities: Mapping[str, float]


@dataclass(frozen=True)
class Truth:
    """What is true of a session.

    Attributes:
        values: Numbers of the rig by name.
        causes: What is wrong; none in a clean session.
        wrong: Reading by axis, whether it was recorded otherwise than it was measured. A place or a current that was makes all three wrong.
        expected_T: What readings would be without noise, with all that is wrong; None where that is not known.
        noise_T: Of each reading.
    """

    values: Mapping[str, float]
    causes: tuple[TrueCause, ...]
    wrong: npt.NDArray[np.bool_]
    expected_T: npt.NDArray[np.float64] | None = None
    noise_T: npt.NDArray[np.float64] | None = None
    told: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, hidden: HiddenSession, library: Collection[str]) -> Truth:
        """Of a session that the independent generator made."""
        told = hidden.truth()
        causes = tuple(
            TrueCause(
                label(cause),
                cause["place"],
                label(cause) in library,
                cause["visible_sigma"],
                true_quantities(cause),
            )
            for cause in told["causes"]
        )
        causes = tuple(
            one if flaw.cause.has_size else replace(one, sigma=None)
            for one, flaw in zip(causes, hidden.flaws, strict=True)
        )
        noise_T = hidden.scene.sigma_T.ravel()
        measured = [flaw for flaw in hidden.flaws if flaw.cause.stage < Stage.READOUT]
        made, before = record(hidden.scene, hidden.flaws, None), record(hidden.scene, measured, None)
        off_T = np.abs(before.field_T - record(hidden.scene, (), None).field_T)
        written_T = np.abs(made.field_T - before.field_T)
        moved = np.abs(made.displacement_m - before.displacement_m).max(axis=1) > 0.0
        written_T[moved | (made.current_A != before.current_A)] = np.inf
        wrong = _sharp(off_T, noise_T) | (written_T > SHARP_SIGMA * noise_T[:, None])
        return cls(told["values"], causes, wrong, made.field_T, noise_T, told)

    @property
    def is_clean(self) -> bool:
        """Whether nothing is wrong."""
        return not self.causes and not self.wrong.any()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of what is hidden."""
        return tuple(cause.name for cause in self.causes)

    @property
    def words(self) -> str:
        """What is wrong, for people."""
        causes = [
            f"{c.name} of {c.place}" + (f" ({c.sigma:.0f} sigma)" if c.sigma is not None else "")
            for c in self.causes
        ]
        rows = int(self.wrong.any(axis=1).sum())
        return "; ".join([*causes, *([f"{rows} rows recorded otherwise"] if rows else [])]) or "nothing"

    def numbers(self, names: Iterable[str]) -> dict[str, float]:
        """True values of some of a rig's free numbers: those of the rig, and of the field and the zero that are fitted everywhere.

        Where something else is hidden, that may well be in the room's field, and its true value is not known.
        """
        known = {name: self.values[name] for name in names if name in self.values}
        if not set(self.names) <= EVERYWHERE:
            return known
        hidden = {f"{cause.name}[{cause.place}]": cause.quantities for cause in self.causes}
        for name in names:
            cause_label, _, key = name.rpartition(".")
            if cause_label.partition("[")[0] in EVERYWHERE:
                known[name] = hidden.get(cause_label, {}).get(key, 0.0)
        return known

    def cause(self, name: str) -> TrueCause | None:
        """The hidden cause of a name; None where that is not hidden."""
        return next((cause for cause in self.causes if cause.name == name), None)

    def is_right(self, name: str) -> bool:
        """Whether a name is that of a hidden cause, or sends the laboratory to the same part."""
        return any(name == true or is_relative(name, true) for true in self.names)


def _sharp(off_T: npt.NDArray[np.float64], noise_T: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
    """Rows that are off while most others are not at all; none where the effect is there everywhere."""
    in_sigma = off_T / noise_T[:, None]
    is_touched = in_sigma.max(axis=1) > SMOOTH_SIGMA
    wrong: npt.NDArray[np.bool_] = in_sigma > SHARP_SIGMA
    return wrong if is_touched.mean() < MOST_SHARE else np.zeros_like(wrong)
