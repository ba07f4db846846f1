"""How near the noise any correction could come in sessions of the open world; run it after `scripts.studies.open_world`, with its file.

Of each session the true disturbance is known without noise. Unlimited smooth fits (Gaussian processes over time, place, field, current,
moves and what was before) follow it where readings were fitted and predict it where none were; the best of them is chosen in hindsight.
What neither they nor corrections reach is mostly what no model can predict: a jump between two readings, or what comes after all others.
A perfect model too is near the noise by chance only, so corrections are also compared with what the true field leaves.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from estimator.effects import EFFECTS
from scripts.studies.hidden_cases import Row, noise_T, read, share_and_interval, truth_of
from scripts.studies.open_world import NEAR_NOISE
from tests.hidden.causes.outside import as_if_all_were
from tests.hidden.flaw import record
from tests.hidden.handed_in import HiddenSession
from tests.hidden.protocols import Array
from tests.hidden.study import draw_case

LENGTHS = (0.03, 0.1, 0.3, 1.0, 3.0)  # of the range of each feature
NUGGET = 1e-6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path, help="rows of the study")
    rows = [row for row in read(parser.parse_args().file).values() if row.get("gain")]
    for kind in sorted({row["kind"] for row in rows}):
        show(kind, [row for row in rows if row["kind"] == kind])


def show(kind: str, rows: list[Row]) -> None:
    """A line for each session, then shares."""
    errors = []
    for row in rows:
        before, after = (row["gain"][when]["vector_T"] / noise_T(row) for when in ("before", "after"))
        perfect, smooth = errors_of(draw_case(kind, row["seed"], EFFECTS), noise_T(row))
        errors.append((perfect, smooth, after))
        print(
            f"{kind} {row['seed']} {row['protocol']:11} {truth_of(row):20} truth known {perfect:.2f}, smooth fit {smooth:.2f}, "
            f"before {before:.2f}, after {after:.2f}"
        )
    table = np.array(errors)
    is_near = table <= NEAR_NOISE
    shares = {
        "the truth known": is_near[:, 0],
        "smooth fit to the truth": is_near[:, 1],
        "after": is_near[:, 2],
        "after or smooth fit": is_near[:, 1:].any(axis=1),
    }
    print(f"{kind}: {len(rows)} sessions, error on unseen readings within {NEAR_NOISE} of the noise")
    for words, ones in shares.items():
        print(f"  {words:24} {share_and_interval(int(ones.sum()), len(rows))}")
    as_good = table[:, 2] <= NEAR_NOISE * table[:, 0]
    print(
        f"  after, within {NEAR_NOISE} of what the truth leaves: {share_and_interval(int(as_good.sum()), len(rows))}"
    )


def errors_of(hidden: HiddenSession, noise_T: float) -> tuple[float, float]:
    """Error on unseen readings over the noise: of the truth itself, and of the best smooth fit to the true disturbance."""
    truth_T = record(hidden.scene, hidden.flaws, None).field_T
    disturbance_T = truth_T - record(hidden.scene, (), None).field_T
    unseen = hidden.schedule.is_validation
    noise_left_T = (hidden.record.field_T - truth_T)[unseen]
    missed_T = min(
        (_missed_T(kernel, disturbance_T, unseen) for kernel in kernels(hidden)),
        key=lambda error_T: float(np.square(error_T).sum()),
    )
    return _rms(noise_left_T) / noise_T, _rms(noise_left_T + missed_T) / noise_T


def kernels(hidden: HiddenSession) -> Iterator[Array]:
    """Covariances of the disturbance between readings, alike for each component."""
    scene, schedule = hidden.scene.measured(), hidden.schedule
    field_T = scene.readings_T
    same = (schedule.sensor[:, None] == schedule.sensor).astype(float)
    place = schedule.displacement_m
    if schedule.joint_rad is not None:
        place = np.concatenate((place, schedule.joint_rad), axis=1)
    by_current = schedule.current_A[:, None] / np.abs(schedule.current_A).max()
    history_T = np.zeros_like(field_T)
    for which in range(len(schedule.sensors)):
        own = as_if_all_were(scene, which)
        mine = schedule.sensor == which
        history_T[mine] = (np.concatenate((own[:1], own[:-1])) - own)[mine]
    move_m = np.diff(schedule.displacement_m, axis=0, prepend=schedule.displacement_m[:1])
    last = np.maximum.accumulate(np.arange(len(move_m)) * (np.abs(move_m).sum(axis=1) > 0.0))
    step_A = np.concatenate((by_current[:1], by_current[:-1]))
    linear, current, past = _inner(field_T), 1.0 + by_current * by_current.T, _inner(history_T)
    size_T = np.abs(field_T).max(axis=1, keepdims=True)
    for length in LENGTHS:
        time = _rough(schedule.time_s[:, None], length)
        here = _smooth(place, length)
        yield time * same
        yield time * linear
        yield time * current * _smooth(place, 1.0)
        yield here * current * same
        yield here * linear * same
        yield _smooth(field_T, length) * same
        yield _rough(size_T, length) * linear * same
        yield _rough(field_T, length) * same
        yield _smooth(np.concatenate((by_current, step_A), axis=1), length) * linear
        yield _rough(move_m[last], length) * current * _smooth(place, 1.0)
        yield _smooth(schedule.time_s[:, None], length) * past
        yield _smooth(np.concatenate((field_T, history_T), axis=1), length) * same


def _missed_T(kernel: Array, disturbance_T: Array, unseen: npt.NDArray[np.bool_]) -> Array:
    """What a Gaussian process misses of a disturbance where nothing was fitted."""
    among = kernel[~unseen][:, ~unseen]
    among = among + NUGGET * np.trace(among) / len(among) * np.eye(len(among))
    follows = np.linalg.solve(among, disturbance_T[~unseen])
    return np.asarray(disturbance_T[unseen] - kernel[unseen][:, ~unseen] @ follows)


def _scaled(features: Array) -> Array:
    spread = np.ptp(features, axis=0)
    return np.asarray(features / np.where(spread > 0.0, spread, 1.0))


def _smooth(features: Array, length: float) -> Array:
    """Squared exponential."""
    scaled = _scaled(features)
    return np.asarray(
        np.exp(-0.5 * np.square(scaled[:, None] - scaled).sum(-1) / (length**2 * features.shape[1]))
    )


def _rough(features: Array, length: float) -> Array:
    """Exponential, as of what wanders at random or jumps."""
    scaled = _scaled(features)
    distance = np.sqrt(np.square(scaled[:, None] - scaled).sum(-1))
    return np.asarray(np.exp(-distance / (length * np.sqrt(features.shape[1]))))


def _inner(vectors: Array) -> Array:
    return np.asarray(vectors @ vectors.T / np.square(vectors).sum(1).mean())


def _rms(vectors: Array) -> float:
    return float(np.sqrt(np.square(vectors).sum(1).mean()))


if __name__ == "__main__":
    main()
