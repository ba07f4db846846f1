"""Checks before a fit: can these readings determine anything, and are they in the units they claim?"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NoReturn

import numpy as np
import torch

from estimator.errors import Faults, InvalidInput
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig, UnwoundCoil

MOST_READINGS = 300
PLAUSIBLE_RATIO = 20.0
MUCH_BETTER = 0.25  # of 1 - correlation: another unit has to explain what the given one does not
SINGLE_ERROR = 0.05  # of the noise: added as a square, it widens no interval by more than 0.2 %
FIELD_UNITS = {"mT": 1e3, "uT": 1e6, "G": 1e4}


def check_precision(rig: Rig, observations: Observations) -> None:
    """Refuse single precision where it would be seen: where it changes a prediction by more than a part of the sensor's noise.

    Args:
        rig: Its nominal values are where predictions are compared.
        observations: Readings in double precision.
    Raises:
        InvalidInput: Predictions in single precision differ by more than `SINGLE_ERROR` standard deviations.
    """
    single, double = (
        MeasurementModel.build(rig, readings)
        for readings in (observations.to(dtype=torch.float32), observations)
    )
    noise_T = torch.stack([double.nominal[f"{sensor.name}.noise_T"] for sensor in rig.sensors])
    error_T = (single.predict(single.nominal) - double.predict(double.nominal)).abs().amax(-1)
    worst = float((error_T / noise_T[observations.sensor]).nan_to_num().max())
    if worst > SINGLE_ERROR:
        raise InvalidInput(
            f"precision must be double for fields this large: single precision changes a prediction by {worst:.2g} times the noise of "
            f"its sensor, and may change it by {SINGLE_ERROR:g} times"
        )


def check_readings(
    rig: Rig,
    observations: Observations,
    where: str,
    needs_current: bool = True,
    faults: Faults | None = None,
) -> None:
    """Refuse readings that cannot support a fit.

    Args:
        rig: The rig that was measured.
        observations: All readings; those that a fit would use have to suffice.
        where: File or session that messages name.
        needs_current: A coil without current tells nothing of itself, but much of sensors and room.
        faults: What becomes of faults; without it the first is raised.
    Raises:
        InvalidInput: A value that is not finite; no reading to fit, or fewer components than free parameters; no current; no field; no
            motion.
    """
    faults = faults or Faults()
    with faults.noting():
        _check_values(observations, where)
    observations = observations.calibration
    if len(observations) < 2:
        with faults.noting():
            _refuse_too_few(len(observations), where)
        return
    n_components, n_free = int(observations.is_measured.sum()), len(rig.free)
    if n_components < n_free:
        rule = f"readings must hold at least as many components as there are free parameters ({n_free})"
        faults.note(InvalidInput(f"{rule}; received {n_components} ({where})"))
    if needs_current and (observations.current_A == 0.0).all():
        faults.note(InvalidInput(f"at least one coil must carry current; all currents are 0 A ({where})"))
    if (observations.field_sensor_T[observations.is_measured] == 0.0).all():
        faults.note(InvalidInput(f"sensors must show a field; every component is 0 T ({where})"))
    motions = [observations.motion[mover.name] for mover in rig.movers]
    poses = torch.cat([observations.sensor[:, None].double(), *motions], dim=1)
    if bool((poses == poses[0]).all()):
        words = f"readings must be taken at several poses; all {len(observations)} share one ({where})"
        faults.note(InvalidInput(words))


def _refuse_too_few(n_readings: int, where: str) -> NoReturn:
    if n_readings:
        raise InvalidInput(
            f"a calibration needs readings at several poses; received a single reading ({where})"
        )
    raise InvalidInput(f"session must hold calibration readings; it holds none ({where})")


def _check_values(observations: Observations, where: str) -> None:
    tensors = {"time": observations.time_s, "current": observations.current_A}
    tensors |= {f"motion of {name}": motion for name, motion in observations.motion.items()}
    for name, tensor in tensors.items():
        bad = (~torch.isfinite(tensor)).nonzero()
        if len(bad):
            value = tensor[tuple(bad[0])].item()
            raise InvalidInput(
                f"{name} must be finite; received {value} at reading {int(bad[0, 0])} ({where})"
            )
    infinite = torch.isinf(observations.field_sensor_T).any(dim=1).nonzero().flatten()
    if len(infinite):
        raise InvalidInput(f"field must be finite or empty; reading {int(infinite[0])} is infinite ({where})")
    empty = (~observations.is_measured.any(dim=1)).nonzero().flatten()
    if len(empty):
        raise InvalidInput(
            f"every reading must hold at least one component; reading {int(empty[0])} holds none ({where})"
        )


@dataclass(frozen=True)
class _Agreement:
    ratio: float
    correlation: float


def check_units(rig: Rig, observations: Observations, where: str) -> None:
    """Refuse readings whose size or pattern only fits the rig's nominal model in another unit, and name the likely one.

    Raises:
        InvalidInput: Measured and nominal field differ by more than a factor of 20, or only another unit of length or angle makes the
            pattern fit.
    """
    if len(observations) > MOST_READINGS:
        index = np.random.default_rng(0).choice(len(observations), MOST_READINGS, replace=False)
        observations = observations.rows(torch.from_numpy(np.sort(index)))
    given = _agreement(rig, observations)
    is_plausible = given is not None and 1.0 / PLAUSIBLE_RATIO < given.ratio < PLAUSIBLE_RATIO
    if given is not None and is_plausible and given.correlation > 0.9:
        return
    misfit = 1.0 - (given.correlation if given is not None else 0.0)
    for kind, factor, unit in (
        ("positions", 1e-3, "mm"),
        ("positions", 1e-2, "cm"),
        ("rotations", np.pi / 180.0, "degrees"),
    ):
        agreement = _agreement(rig, _scaled(rig, observations, kind, factor))
        if (
            agreement is not None
            and 1.0 / 3.0 < agreement.ratio < 3.0
            and agreement.correlation > 0.7
            and 1.0 - agreement.correlation < MUCH_BETTER * misfit
        ):
            raise InvalidInput(
                f"{kind} of the movers must be in {'metres' if kind == 'positions' else 'radians'}; they look like {unit}: "
                f"divided by {1.0 / factor:.4g} they fit the rig's nominal model ({where})"
            )
    if given is None or is_plausible:
        return
    unit_ratio = min(FIELD_UNITS.items(), key=lambda item: abs(np.log(given.ratio / item[1])))
    if 1.0 / 3.0 < given.ratio / unit_ratio[1] < 3.0:
        likely = f"fields look like {unit_ratio[0]} (or currents are too small by {unit_ratio[1]:g})"
    elif 1.0 / 3.0 < given.ratio * 1e3 < 3.0:
        likely = "currents look like mA (or fields are too small by 1000)"
    else:
        likely = "check units, currents and the nominal pose"
    raise InvalidInput(
        f"measured and nominal field must agree to a factor of {PLAUSIBLE_RATIO:g}; their ratio is {given.ratio:.3g}: {likely} ({where})"
    )


def _agreement(rig: Rig, observations: Observations) -> _Agreement | None:
    """Ratio of sizes and correlation of patterns of measured and nominal field; None where a sensor would sit in a winding."""
    try:
        model = MeasurementModel.build(rig, observations, tolerance=1e-3)
    except InvalidInput:
        return None
    nominal = {name: torch.tensor(v, dtype=torch.float64) for name, v in rig.nominal_values().items()}
    has_current = observations.current_A != 0.0
    is_wound = torch.tensor([not isinstance(coil, UnwoundCoil) for coil in rig.coils])
    # Nothing is known beforehand of the field of a coil without a winding.
    powered = has_current.any(dim=1) & ~(has_current & ~is_wound).any(dim=1)
    mask = observations.is_measured & powered[:, None]
    predicted, measured = model.predict(nominal)[mask], observations.field_sensor_T[mask]
    norm = float(predicted.norm()), float(measured.norm())
    if not len(measured) or min(norm) == 0.0:
        return None
    return _Agreement(norm[1] / norm[0], float((predicted * measured).sum()) / (norm[0] * norm[1]))


def _scaled(rig: Rig, observations: Observations, kind: str, factor: float) -> Observations:
    motion = {}
    for mover in rig.movers:
        scaled = observations.motion[mover.name].clone()
        is_joint = mover.table is not None
        columns = slice(0, 6) if is_joint else slice(3, 6) if kind == "rotations" else slice(0, 3)
        if not (is_joint and kind == "positions"):
            scaled[:, columns] *= factor
        motion[mover.name] = scaled
    return replace(observations, motion=motion)
