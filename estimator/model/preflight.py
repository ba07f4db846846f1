"""Checks before a fit: can these readings determine anything? Their units are judged in `unit_gate`."""

from __future__ import annotations

from typing import NoReturn

from estimator.errors import Faults, InvalidInput
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.tensors import torch

SINGLE_ERROR = 0.05  # of the noise: added as a square, it widens no interval by more than 0.2 %


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
    rig: Rig, observations: Observations, where: str, needs_current: bool = True, faults: Faults | None = None
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
    is_fitted = ~observations.is_validation  # what follows copies no million of readings
    n_fitted = int(is_fitted.sum())
    if n_fitted < 2:
        with faults.noting():
            _refuse_too_few(n_fitted, where)
        return
    is_measured = observations.is_measured & is_fitted[:, None]
    n_components, n_free = int(is_measured.sum()), len(rig.free)
    if n_components < n_free:
        rule = f"readings must hold at least as many components as there are free parameters ({n_free})"
        n_unseen = len(observations) - n_fitted
        besides = (
            f" without the {n_unseen} of {len(observations)} readings for validation" if n_unseen else ""
        )
        remedy = "take more, or write numbers that you know without a prior in the rig file"
        if int(observations.is_measured.sum()) >= n_free:
            remedy += ", or keep fewer of them for validation"
        faults.note(InvalidInput(f"{rule}; received {n_components}{besides}: {remedy} ({where})"))
    if needs_current and (observations.current_A[is_fitted] == 0.0).all():
        faults.note(InvalidInput(f"at least one coil must carry current; all currents are 0 A ({where})"))
    if (observations.field_sensor_T[is_measured] == 0.0).all():
        faults.note(InvalidInput(f"sensors must show a field; every component is 0 T ({where})"))
    first = int(is_fitted.nonzero()[0])
    of_pose = [observations.sensor, *(observations.motion[mover.name] for mover in rig.movers)]
    if all(bool((part[is_fitted] == part[first]).all()) for part in of_pose):
        words = f"readings must be taken at several poses; all {n_fitted} share one ({where})"
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
