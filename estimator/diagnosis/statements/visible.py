"""What the readings of a diagnosis could have shown, and what free numbers of the rig absorb, so that they could not."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from estimator.diagnosis.intervals import CLEAR_SD
from estimator.diagnosis.next_readings.resolution import TYPICAL_SIGMA, Visible
from estimator.diagnosis.result import Diagnosis
from estimator.effects import EFFECTS, ORDER
from estimator.effects.base import Kind
from estimator.effects.circumstances import SINCE, UNTIL
from estimator.readings.flags import COMPONENTS
from estimator.readings.observations import SECONDS_PER_HOUR
from estimator.reporting.numbers import Display, displays, quantity_words, size_with_unit
from estimator.reporting.page import Table
from estimator.rig.rig import Cause
from estimator.units import split_quotient

PLACE = ("x_m", "y_m", "z_m")  # keys of a place
PLANE = ("axis", "distance_m")  # keys of a plane: the axis across it, and where it crosses that axis
LEAST_UNSEEN = 0.1  # share of usual sizes that stay unseen from which on one is told
AT_TYPICAL_SIZE = f"at {TYPICAL_SIGMA:.0f} standard deviations"  # larger causes they may tell apart
KINDS_TOLD = (Kind.ROOM, Kind.COIL, Kind.SENSOR, Kind.MOVER)


def would_have_shown(diagnosis: Diagnosis, readings: str) -> str:
    """The smallest visible size of the first cause of the library that shows, of a coil, a sensor and a mover each.

    Args:
        diagnosis: Which this is about.
        readings: What the readings are called in the sentence.
    """
    easiest_first = sorted(diagnosis.left_open.visible, key=lambda v: v.size / v.prior_sd)
    shown = [v for v in easiest_first if v.is_visible and not EFFECTS[v.cause.name].is_record_mistake]
    first = _one_of_each_kind(sorted(shown, key=lambda v: ORDER[v.cause.name]), KINDS_TOLD[1:])
    sizes = [
        f"{diagnosis.label(v.cause)} {quantity_words(v.key)} from {size_with_unit(v.size, v.unit)}"
        for v in first
    ]
    return f"; {readings} would have shown, for example, {', '.join(sizes)}" if sizes else ""


def hidden_words(diagnosis: Diagnosis) -> str:
    """What a session could not have shown though it would move numbers of the rig, in one sentence; empty where there is nothing.

    One cause each of the room, a coil, a sensor and a mover: the one that would move a number most, times the share of usual sizes that
    stay unseen where it does. A source that is built otherwise is none of them, for any number absorbs some of these.
    """
    most_first = sorted(diagnosis.left_open.visible, key=lambda v: -v.hidden_sd * _share_unseen(v))
    most = _one_of_each_kind(filter(_is_hidden, most_first), KINDS_TOLD)
    each = [_hidden(diagnosis, visible) for visible in most]
    return f"These readings could not have shown, for example: {'; '.join(each)}." if each else ""


def _one_of_each_kind(ranked: Iterable[Visible], kinds: Sequence[Kind]) -> list[Visible]:
    """The first quantity that belongs to each of some kinds, in the order of the kinds."""
    first: dict[Kind, Visible] = {}
    for visible in ranked:
        first.setdefault(EFFECTS[visible.cause.name].kind, visible)
    return [first[kind] for kind in kinds if kind in first]


def _is_hidden(visible: Visible) -> bool:
    """Whether a usual size of a quantity would move a number of the rig unseen."""
    is_usual = _share_unseen(visible) > LEAST_UNSEEN and visible.hidden_sd > CLEAR_SD
    return is_usual and not EFFECTS[visible.cause.name].is_structural


def _hidden(diagnosis: Diagnosis, visible: Visible) -> str:
    """A quantity, where and up to what size it stays unseen, which number of the rig absorbs it, and how wrong that may be."""
    number = _display(diagnosis, [visible.hidden_in])[visible.hidden_in].words
    size = f"{quantity_words(visible.key)} {size_with_unit(visible.hidden_size, visible.unit)}"
    unit = split_quotient(visible.hidden_in)[1]
    # Of turns a share is told; of a gain that is the same.
    shift = abs(visible.hidden_shift) / (1.0 if unit else max(1.0, abs(visible.hidden_from)))
    wrong = size_with_unit(shift, unit.symbol if unit else "1")
    return (
        f"{EFFECTS[visible.cause.name].words} ({visible.cause.label}), up to {f'{size} {where(visible.hidden_at)}'.rstrip()}: "
        f"{number} would absorb it, and be wrong by up to {wrong} ({visible.hidden_sd:.0f} standard deviations)"
    )


def _share_unseen(visible: Visible) -> float:
    """Share of the sizes of a quantity, up to its prior's standard deviation, that stay unseen at the start that hides most."""
    return visible.hidden_size / visible.prior_sd


def visible_tables(diagnosis: Diagnosis) -> Iterator[Table]:
    """The smallest visible size of every cause, where that is, and what absorbs more of it."""
    of_cause: dict[Cause, list[Visible]] = {}
    for quantity in diagnosis.left_open.visible:
        of_cause.setdefault(quantity.cause, []).extend([quantity] if quantity.is_visible else [])
    rows = [
        [
            cause.label,
            "; ".join(f"{quantity_words(v.key)} {size_with_unit(v.size, v.unit)}" for v in own),
            where(own[0].at) or "—",
            absorbing(diagnosis, own),
        ]
        for cause, own in of_cause.items()
        if own
    ]
    caption = (
        "Sizes that would change these readings by five standard deviations if nothing else were wrong, beyond what free numbers of the "
        "rig absorb. Those that absorb more than half of it are named."
    )
    if hidden := sorted(cause.label for cause, own in of_cause.items() if not own):
        caption += f" Not visible at any plausible size: {', '.join(hidden)}."
    if diagnosis.left_open.twins:
        caption += f" These readings cannot tell apart {AT_TYPICAL_SIZE}: {twins(diagnosis)}."
    header = ["cause", "smallest visible size", "there", "absorbed by"]
    yield Table("What these readings can show", header, rows, caption)


def twins(diagnosis: Diagnosis) -> str:
    """Groups of causes that these readings cannot tell apart where one of them has a typical size."""
    groups = diagnosis.left_open.twins
    return "; ".join(" = ".join(diagnosis.label(cause) for cause in group) for group in groups)


def where(at: Mapping[str, float]) -> str:
    """Place and instants among the shapes of a cause, in words; empty where there are none.

    Examples:
        >>> where({"x_m": 0.01, "y_m": -0.02, "z_m": -1e-6, "since_h": 0.5})
        'at (10, −20, 0) mm, from 1800 s on'
        >>> where({"axis": 2.0, "distance_m": -0.041})
        'at z = −41 mm'
        >>> where({"tau_h": 1.0})
        ''
    """
    words = []
    if all(key in at for key in PLANE):
        axis, distance_m = (at[key] for key in PLANE)
        words.append(f"at {COMPONENTS[int(axis)]} = {1e3 * distance_m:.0f} mm")
    if all(key in at for key in PLACE):
        words.append(f"at ({', '.join(f'{round(1e3 * at[key])}' for key in PLACE)}) mm")
    if SINCE in at:
        words.append(f"from {SECONDS_PER_HOUR * at[SINCE]:.0f} s on")
    if UNTIL in at:
        words.append(f"until {SECONDS_PER_HOUR * at[UNTIL]:.0f} s")
    return ", ".join(words).replace("-", "−")


def absorbing(diagnosis: Diagnosis, quantities: Sequence[Visible]) -> str:
    """Free numbers of the rig that follow more than half of what some quantities of a cause change; a dash where none do."""
    names = dict.fromkeys(name for visible in quantities for name in visible.absorbed_by)
    display = _display(diagnosis, names)
    return ", ".join(display[name].words for name in names) or "—"


def _display(diagnosis: Diagnosis, names: Iterable[str]) -> dict[str, Display]:
    """Words of some numbers beside those of all free ones."""
    return displays(list(dict.fromkeys([*(parameter.name for parameter in diagnosis.rig.free), *names])))
