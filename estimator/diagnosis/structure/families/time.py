"""Curves in time: slow ones, changes and spells in mid-session, periods of any length, and what wanders."""

from __future__ import annotations

import math
from itertools import combinations

import torch
from scipy.linalg import eigh
from torch import Tensor

from estimator.devices import numpy_of
from estimator.diagnosis import policy
from estimator.diagnosis.structure.families.collection import Collection, by_sensor, subsets
from estimator.diagnosis.structure.families.unit_field import unit_field_T
from estimator.diagnosis.structure.smooth import legendre
from estimator.effects.circumstances import Circumstances
from estimator.model.nominal import gradient_T_per_m
from estimator.readings.cycles import CYCLE, cycle_of_currents_s, is_of_cycle
from estimator.readings.observations import SECONDS_PER_HOUR

PERIODS_AT_ONCE = 32  # which bounds the memory
OF_ALL_SENSORS = "a change of coil, mover or room in mid session"


def add_time(collection: Collection) -> None:
    """Add all families in time."""
    circumstances = collection.fit.posterior.model.circumstances
    time = 2.0 * circumstances.hours / circumstances.duration_h - 1.0
    clock = legendre(time, policy.TIME_DEGREE)[:, 1:]
    collection.add("time", clock[:, 1:], collection.axes)
    collection.add("field and time", clock, collection.along_field)
    instants = torch.linspace(-1.0, 1.0, policy.N_INSTANTS + 2).tolist()[1:-1]
    for sensor, seen in by_sensor(circumstances):
        _add_changes(collection, time, instants, seen, sensor)
    _add_changes_of_all(collection, time, instants)
    for sensor, seen in subsets(circumstances):
        _add_spells(collection, time, instants, seen, sensor)
        _add_periods(collection, circumstances, seen, sensor)
        _add_wandering(collection, circumstances, seen, sensor)


def _add_changes(
    collection: Collection, time: Tensor, instants: list[float], seen: Tensor, sensor: str
) -> None:
    """Add changes of what a sensor shows from an instant on: a constant, a share of each component, or both with cross terms."""
    mixed = torch.cat([torch.diag_embed(torch.roll(collection.field, k, dims=1)) for k in range(3)], dim=-1)
    everything = torch.cat((collection.axes, mixed), dim=-1)
    for instant in instants:
        later = ((time > instant) * seen)[:, None]
        if bool(later.any()):
            for vectors in (collection.axes, collection.along_field, everything):
                collection.add("a change in mid session", later, vectors, sensor)


def _add_changes_of_all(collection: Collection, time: Tensor, instants: list[float]) -> None:
    """Add changes from an instant on at all sensors: of a coil's field, of where a mover stands, or of the room's field."""
    fit, model = collection.fit, collection.fit.posterior.model
    circumstances = model.circumstances
    share = circumstances.current_A / circumstances.largest_current_A
    changes = {
        coil.name: (unit_field_T(fit, i) * share[:, i, None])[:, :, None]
        for i, coil in enumerate(fit.rig.coils)
    }
    changes |= {mover.name: gradient_T_per_m(model, fit.values, mover.name) for mover in fit.rig.movers}
    if len(by_sensor(circumstances)) > 1:  # else it is that of the sensor's zero
        with torch.no_grad():
            turn = model.world_from_sensor(model.every_row, fit.values).rotation
        changes["room"] = turn.expand(len(model.every_row), 3, 3)[model.pose_row].mT
    later = torch.stack([(time > instant).to(time) for instant in instants])
    later = later[later.any(1)]
    for place, vectors in changes.items():
        collection.add_alike(OF_ALL_SENSORS, later[:, :, None], vectors, [place] * len(later))


def _add_spells(
    collection: Collection, time: Tensor, instants: list[float], seen: Tensor, sensor: str
) -> None:
    """Add spells between two instants, in which a sensor shows a constant or a share of each component beside."""
    spells = [(time > begin) * (time <= end) * seen for begin, end in combinations(instants, 2)]
    during = torch.stack([spell for spell in spells if bool(spell.any())] or [torch.zeros_like(time)])
    if bool(during.any()):
        for vectors in (collection.axes, collection.along_field):
            collection.add_alike(
                "a spell in mid session", during[:, :, None], vectors, [sensor] * len(during)
            )


def _add_periods(collection: Collection, circumstances: Circumstances, seen: Tensor, sensor: str) -> None:
    """Sinusoids of all periods from twice the session down to two typical times between readings, of a field and of a gain.

    Shorter periods are seen at their aliases. Half a cycle per session between frequencies loses at most a fifth of the power.

    References: Lomb, Astrophys. Space Sci. 39, 447 (1976); Scargle, Astrophys. J. 263, 835 (1982): least-squares periodogram.
    """
    time_s = circumstances.observations.history.time_s
    typical_h = (
        float(torch.diff(time_s.unique()).median()) / SECONDS_PER_HOUR
        if len(time_s.unique()) > 1
        else math.inf
    )
    n_instants = round(circumstances.duration_h / typical_h)
    cycle_s = cycle_of_currents_s(circumstances.observations)
    half_cycles = torch.arange(1, min(n_instants, policy.MOST_PERIODS) + 1, device=time_s.device)
    for some in half_cycles.split(PERIODS_AT_ONCE) if len(half_cycles) else ():
        phase = math.pi * some[:, None] * circumstances.hours / circumstances.duration_h
        waves = torch.stack((torch.cos(phase), torch.sin(phase)), dim=-1) * seen[:, None]
        periods_s = 2.0 * SECONDS_PER_HOUR * circumstances.duration_h / some
        session_s = SECONDS_PER_HOUR * circumstances.duration_h
        details = [
            ", ".join(filter(None, (_period_words(period_s, session_s, cycle_s), sensor)))
            for period_s in periods_s.tolist()
        ]
        for vectors in (collection.axes, collection.along_field):
            collection.add_alike("a period in time", waves, vectors, details)


def _period_words(period_s: float, session_s: float, cycle_s: float | None = None) -> str:
    """A period, which is none but a slow change where the session is shorter, and may be that in which currents were commanded.

    Examples:
        >>> _period_words(60.0, 3600.0), _period_words(7200.0, 3600.0)
        ('about 60 s', 'so long that it is one slow change in the session')
        >>> _period_words(6.0, 240.0, 6.0)
        'about 6 s, the cycle of the commanded currents'
    """
    if period_s > session_s:
        return "so long that it is one slow change in the session"
    is_cycle = is_of_cycle(period_s, cycle_s, session_s)
    return f"about {period_s:.3g} s{f', {CYCLE}' if is_cycle else ''}"


def _add_wandering(collection: Collection, circumstances: Circumstances, seen: Tensor, sensor: str) -> None:
    """What keeps its value for a while and then forgets it: an Ornstein-Uhlenbeck process, by its largest principal components."""
    apart_h = (circumstances.hours[:, None] - circumstances.hours[None, :]).abs()
    for share in policy.WANDERING_SHARES:
        kernel = torch.exp(-apart_h / (share * circumstances.duration_h)) * seen[:, None] * seen[None, :]
        n = len(kernel)
        largest = (max(n - policy.WANDERING_COMPONENTS, 0), n - 1)
        # On the processor: SciPy finds the few largest alone.
        eigenpairs = eigh(numpy_of(kernel), subset_by_index=largest)
        size, vectors = (torch.from_numpy(numbers).to(kernel.device) for numbers in eigenpairs)
        components = vectors * size.clamp(min=0.0).sqrt()
        for directions in (collection.axes, collection.along_field):
            collection.add("wandering in time", components, directions, sensor)
