"""What the extension does to the numbers of the rig, and what each cause does to them."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from estimator.derivatives import jacobian_of
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.panel_records import Moved, Shown
from estimator.diagnosis.result import Diagnosis
from estimator.reporting.numbers import displays, with_sd
from estimator.reporting.page import Table
from estimator.rig.rig import Cause

LISTED_IMPACT_SD = 0.3  # that a cause must move a number of the rig for its impact to be listed
MOVED_SD = 1.0  # that a number of the rig must move to be listed


def impact_sd(fit: Fit, cause: Cause) -> dict[str, float]:
    """Shift of each free parameter, in its standard deviations, if the cause were put to its null and the others fitted again.

    To first order: covariance with the cause's quantities, over their covariance, times their distance from the null.

    Args:
        fit: With the cause.
        cause: One of its rig.
    Returns: By name of the parameter; empty where no quantity of the cause is free, or where one cannot be at its null.
    References: ATLAS and CMS, ATL-PHYS-PUB-2011-11, for impacts and pulls of nuisance parameters.
    """
    coordinates = fit.posterior.coordinates
    own, null = fit.at_null(cause)
    if not own or not bool(torch.isfinite(null).all()):
        return {}
    within = fit.covariance[own][:, own]
    shift = fit.covariance[:, own] @ torch.linalg.solve(within, null - fit.vector[own])
    names = [name for name in coordinates.names if not name.startswith(f"{cause.label}.")]

    def numbers(vector: Tensor) -> Tensor:
        values = coordinates.values(vector)
        return torch.stack([values[name] for name in names], dim=-1)

    slopes = jacobian_of(numbers, fit.vector)  # a winding's parameters are not its coordinates
    sd = (slopes @ fit.covariance * slopes).sum(-1).sqrt()
    return dict(zip(names, (slopes @ shift / sd).tolist(), strict=True))


MOST_COLUMNS = 6
MOVED_TITLE = "Parameters that the extension moves"
NO_LONGER_DETERMINED = "no longer determined"


def moved_tables(diagnosis: Diagnosis) -> Iterator[Table]:
    """Numbers of the rig that lie elsewhere, and how far each cause pulls them; none where no readings were kept out."""
    if diagnosis.improvement is not None:
        yield from (table for table in (_moved_table(diagnosis), _impact_table(diagnosis)) if table.rows)


def _moved_table(diagnosis: Diagnosis) -> Table:
    loosened = diagnosis.no_longer_determined
    far = [number for number in moved(diagnosis) if abs(number.moved_sd) > MOVED_SD]
    rows = []
    for number in sorted(far, key=lambda number: number.shown.name in loosened):
        shown = number.shown
        before, after = (
            with_sd(value * shown.factor, sd * shown.factor) for value, sd in (number.before, number.after)
        )
        distance = NO_LONGER_DETERMINED if shown.name in loosened else _signed(number.moved_sd)
        rows.append([shown.words, before, after, shown.unit or "1", distance])
    return Table(
        MOVED_TITLE,
        ["parameter", "before", "after", "unit", "moved (sd)"],
        rows,
        "Parameters of the rig that lie elsewhere by more than one standard deviation of the plain fit. What the extended rig knows "
        f"clearly less well is marked as {NO_LONGER_DETERMINED}: its shift does not mean that it was wrong.",
    )


def _impact_table(diagnosis: Diagnosis) -> Table:
    """How far each cause pulls each parameter, as particle physicists list the pulls of systematic errors."""
    stand_ins = diagnosis.findings.stand_ins
    before = diagnosis.fits.plain.rig.effects
    added = [cause for cause in diagnosis.fits.final.rig.effects if cause not in before]
    causes = sorted(added, key=lambda cause: cause in stand_ins)[:MOST_COLUMNS]
    by_name = {number.shown.name: number for number in moved(diagnosis)}
    rows = []
    for number in (by_name[name] for name in _rig_numbers(diagnosis) if name in by_name):
        pulls = [number.pulls_sd.get(diagnosis.label(cause), 0.0) for cause in causes]
        if max(map(abs, pulls), default=0.0) > LISTED_IMPACT_SD:
            rows.append([number.shown.words, *map(_signed, pulls)])
    return Table(
        "Impact of each cause",
        ["parameter", *(diagnosis.label(c) + (" (not sure)" if c in stand_ins else "") for c in causes)],
        rows,
        "How far each parameter of the rig would move, in its standard deviations, if one cause were left out and the others stayed.",
    )


def moved(diagnosis: Diagnosis) -> list[Moved]:
    """Free numbers of the rig before and after, by fits to the same readings where there are such; those that moved farthest first."""
    plain, final, names = diagnosis.fits.plain, diagnosis.fits.final, _rig_numbers(diagnosis)
    known = {} if diagnosis.improvement is None else diagnosis.improvement.known_before
    impacts = {diagnosis.label(cause): impact_sd(final, cause) for cause in final.rig.effects}
    display = displays(names)
    result = []
    for name in names:
        before = known.get(name) or (float(plain.values[name]), plain.value_sd(name))
        after = (float(final.values[name]), diagnosis.value_sd(name))
        if before[1] > 0.0 and after[1] > 0.0:
            pulls = {label: impact[name] for label, impact in impacts.items() if name in impact}
            shown = Shown(name, display[name].words, display[name].unit, display[name].factor)
            result.append(Moved(shown, before, after, (after[0] - before[0]) / before[1], pulls))
    return sorted(result, key=lambda moved: -abs(moved.moved_sd))


def moved_words(diagnosis: Diagnosis) -> str:
    """Which numbers would have been wrong without the causes, and which are only known less well; empty where nothing was found."""
    if not diagnosis.sized_causes:
        return ""
    loosened = diagnosis.no_longer_determined
    far = [
        number.shown.words
        for number in moved(diagnosis)
        if abs(number.moved_sd) > MOVED_SD and number.shown.name not in loosened
    ]
    words = "No number of the rig was biased by more than one standard deviation."
    if far:
        words = (
            f"Without the cause, {', '.join(far)} would have been wrong by more than one standard deviation."
        )
    if loosened:
        display = displays([parameter.name for parameter in diagnosis.rig.free])
        names = ", ".join(display[name].words for name in loosened if name in display)
        words += f" With it, clearly less is known of {names}."
    return words


def _rig_numbers(diagnosis: Diagnosis) -> list[str]:
    """Free numbers of the rig as described."""
    names = diagnosis.fits.final.posterior.coordinates.names
    return [parameter.name for parameter in diagnosis.rig.free if parameter.name in names]


def _signed(sd: float) -> str:
    return f"{sd:+.1f}".replace("-", "−")
