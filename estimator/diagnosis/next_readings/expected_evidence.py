"""Which further readings would tell hypotheses apart, or shrink a parameter, before they are taken.

Hypotheses are fits of the same readings. A further reading counts by what they expect of it differently, less what the other could
still adjust; to first order about each fit, the expected log evidence is half the squared distance that is left, and what their scatters
differ by.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.linear import Projector
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig


@dataclass(frozen=True)
class Action:
    """Readings that could be taken next.

    Attributes:
        words: What to do, for the laboratory.
        readings: Their poses and currents; the fields, not known yet, are 0.
        turned: Rotation vectors of sensors that are to be turned first, by name, in their present frames.
    """

    words: str
    readings: Observations
    turned: Mapping[str, tuple[float, float, float]]


@dataclass(frozen=True)
class Proposal:
    """What an action is expected to bring.

    Attributes:
        splits: Labels of the hypotheses.
        expected_log_evidence: That it adds for the true one against the closest of the others, in the worst case of which is true.
    """

    action: Action
    splits: tuple[str, ...]
    expected_log_evidence: float


def proposals(hypotheses: Mapping[str, Fit], actions: Sequence[Action]) -> list[Proposal]:
    """What each action would add to what the readings so far tell hypotheses apart by, best first.

    Args:
        hypotheses: Fits of the same readings by label, two or more.
        actions: Such as `actions` proposes.
    """
    seen = rows_seen(hypotheses)
    so_far = separation(hypotheses, seen)
    found = [
        Proposal(action, tuple(hypotheses), (separation(hypotheses, seen, action) - so_far).min().item())
        for action in actions
    ]
    return sorted(found, key=lambda one: -one.expected_log_evidence)


def rows_seen(hypotheses: Mapping[str, Fit]) -> list[Rows]:
    """What each hypothesis expects of the readings that were fitted."""
    return [Rows.of(fit, fit.observations, fit.rig) for fit in hypotheses.values()]


def separation(
    hypotheses: Mapping[str, Fit], seen: Sequence[Rows], action: Action | None = None
) -> Float[Tensor, " pair"]:
    """Expected log evidence of the readings so far, or after an action, for every ordered pair of truth and rival.

    Args:
        hypotheses: Fits of the same readings by label.
        seen: Their `rows_seen`.
        action: What to do next.
    """
    fits = list(hypotheses.values())
    more: list[Rows] = []
    if action is not None:
        more = [Rows.of(fit, action.readings, _turned(fit.rig, action.turned)) for fit in fits]
    pairs = permutations(range(len(fits)), 2)
    rows = list(zip(seen, more, strict=True)) if more else [(one,) for one in seen]
    return torch.stack([_distance(fits[j], rows[i], rows[j]) for i, j in pairs])


def actions(session: Observations, rig: Rig) -> list[Action]:
    """What a laboratory can do without new equipment: other currents, other order, standing still, a turned sensor."""
    stops = _some_stops(session)
    current_A = session.current_A[stops]
    largest_A = session.current_A.abs().max()
    still = stops[:1].expand(len(stops))
    n = len(stops)
    found = [
        ("the same places again, in random order", stops, current_A),
        ("the same places without current", stops, 0.0 * current_A),
        ("the same places with the current reversed", stops, -current_A),
        ("the same places at half the current", stops, 0.5 * current_A),
        ("one place again and again", still, current_A[:1].expand(n, -1)),
    ]
    several = len(rig.coils) > 1
    for i, coil in enumerate(rig.coils):
        alone = torch.zeros_like(current_A)
        alone[:, i] = largest_A
        if several:
            found.append((f"the same places with {coil.name} alone", stops, alone))
    made = [
        Action(f"{words}, {n} readings", continued(session, rows, currents), {})
        for words, rows, currents in found
    ]
    for sensor in rig.sensors:
        if _orientation(rig, sensor.name) is None:
            continue
        for axis, turn in (("x", (1.0, 0.0, 0.0)), ("z", (0.0, 0.0, 1.0))):
            quarter = tuple(0.5 * torch.pi * part for part in turn)
            made.append(
                Action(
                    f"the same places with {sensor.name} turned by 90 degrees about its {axis} axis, {n} readings",
                    continued(session, stops, current_A),
                    {sensor.name: (quarter[0], quarter[1], quarter[2])},
                )
            )
    return made


@dataclass(frozen=True)
class Rows:
    """What one hypothesis expects of some readings, to first order."""

    predicted_T: Float[Tensor, " component"]
    jacobian_T: Float[Tensor, "component coordinate"]
    sigma_T: Float[Tensor, " component"]

    @classmethod
    def of(cls, fit: Fit, readings: Observations, rig: Rig) -> Rows:
        """Of readings with a rig that differs from that of the fit in fixed numbers only."""
        model = MeasurementModel.unruled(rig, readings).with_rules(fit.posterior.model.rules)
        posterior = LogPosterior(Coordinates(rig), model, readings)
        with torch.no_grad():
            predicted_T = posterior.predicted(fit.vector)
            sigma_T = posterior.component_sigma_T(fit.vector)
        return cls(predicted_T, posterior.jacobian(fit.vector), sigma_T)


def _distance(rival: Fit, truth: tuple[Rows, ...], own: tuple[Rows, ...]) -> Tensor:
    """What readings of the truth are expected to hold against a rival, after it has adjusted its parameters within their priors.

    Half the squared distance of what the two predict, in units of the rival's scatter, and what tells their scatters apart (Kullback and
    Leibler's divergence of two normal distributions).
    """
    sigma_T = torch.cat([rows.sigma_T for rows in own])
    change = torch.cat([t.predicted_T - o.predicted_T for t, o in zip(truth, own, strict=True)]) / sigma_T
    columns = torch.cat([rows.jacobian_T for rows in own]) / sigma_T[:, None]
    prior = (rival.optimum.precision - rival.optimum.information)[0]
    followed = Projector.of(columns, prior).gram(change[:, None], change[:, None])[0, 0]
    wider = (torch.cat([rows.sigma_T for rows in truth]) / sigma_T).square()
    return 0.5 * (followed + (wider - 1.0 - wider.log()).sum())


def _some_stops(session: Observations) -> Tensor:
    """Rows of the session, spread over it in a mixed order, that stand at distinct poses."""
    key = torch.cat([session.sensor[:, None].double(), *session.motion.values()], dim=1)
    _, place = torch.unique(key, dim=0, return_inverse=True)
    first = torch.full((int(place.max()) + 1,), len(place)).scatter_reduce(
        0, place, torch.arange(len(place)), "amin"
    )
    order = torch.randperm(len(first), generator=torch.Generator().manual_seed(0))
    return first[order[: policy.N_STOPS]]


def continued(session: Observations, rows: Tensor, current_A: Tensor) -> Observations:
    """Readings at the poses of some rows, taken after the session at its pace; their history is the session and they."""
    history = session.history
    pace_s = float((history.time_s[-1] - history.time_s[0]) / max(len(history) - 1, 1)) or 1.0
    n = len(rows)
    time_s = history.time_s[-1] + pace_s * torch.arange(1.0, n + 1.0, dtype=torch.float64)

    def both(old: Tensor, new: Tensor) -> Tensor:
        return torch.cat((old, new))

    whole = Observations(
        both(history.time_s, time_s),
        both(history.sensor, session.sensor[rows]),
        both(history.current_A, current_A),
        {name: both(motion, session.motion[name][rows]) for name, motion in history.motion.items()},
        both(history.field_sensor_T, torch.zeros(n, 3, dtype=torch.float64)),
        both(history.is_validation, torch.zeros(n, dtype=torch.bool)),
        both(history.repeat, torch.zeros(n, dtype=history.repeat.dtype)),
        {name: both(values, values.nanmean().expand(n)) for name, values in history.temperature_C.items()},
    )
    return whole.rows(torch.arange(len(history), len(history) + n))


def _orientation(rig: Rig, sensor: str) -> str | None:
    """Prefix of the rotation by which a sensor could be turned; None where it is free, or moves as a displacement."""
    for block in ("world_from_sensor", "flange_from_sensor"):
        names = [f"{sensor}.{block}.{key}" for key in ("rx_rad", "ry_rad", "rz_rad")]
        if all(name in rig.parameters and not rig.parameters[name].is_free for name in names):
            return f"{sensor}.{block}"
    return None


def _turned(rig: Rig, turned: Mapping[str, tuple[float, float, float]]) -> Rig:
    for sensor, turn_rad in turned.items():
        prefix = _orientation(rig, sensor)
        names = [f"{prefix}.{key}" for key in ("rx_rad", "ry_rad", "rz_rad")]
        now = Rotation.from_rotvec([rig.parameters[name].value for name in names])
        new_rad = (now * Rotation.from_rotvec(turn_rad)).as_rotvec()
        rig = rig.with_values(dict(zip(names, new_rad.tolist(), strict=True)))
    return rig
