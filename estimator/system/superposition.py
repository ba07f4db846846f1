"""Tests on readings with all coils on whether separately calibrated coils add up, and bounds coupling and leakage between them.

The readings of the calibrations, with one coil on at a time, and those with all coils on are diagnosed as one session, so that everything
the calibrations know is used. `neighbour_coil` competes there with every other cause, a wrong flange_from_coil (`mount_tilt`) among them.
Each coil's share of its neighbours' currents is then estimated together with the causes that were named.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import reduce

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis.diagnose import diagnose
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.result import Diagnosis
from estimator.effects import COUPLING
from estimator.effects.attach import with_effect
from estimator.errors import InvalidInput
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.metrics import ErrorMetrics, error_metrics
from estimator.readings.observations import Observations
from estimator.rig.coordinates import nominal_tensors
from estimator.rig.rig import Cause
from estimator.store.session import Session
from estimator.system.system import System

GAP_S = 60.0  # between joined sessions, whose clocks have nothing in common
TWO_SIDED_95 = 1.959964


@dataclass(frozen=True)
class Share:
    """Share of its neighbours' currents that a coil carries.

    Attributes:
        share: Share of the summed current of the other coils; 0 without coupling.
        sd: Standard deviation of the share.
        most_T: Largest field that the share makes at a reading, at the far end of its 95 % interval.
    """

    share: float
    sd: float
    most_T: float

    @property
    def largest(self) -> float:
        """Magnitude that the share exceeds with a probability of at most 5 %."""
        return abs(self.share) + TWO_SIDED_95 * self.sd


@dataclass(frozen=True)
class Superposition:
    """Whether coils that were calibrated one at a time add up.

    Attributes:
        errors: Errors of the sum of the separate calibrations on the readings with several coils on, to which nothing is fitted.
        diagnosis: Diagnosis of all readings together.
        shares: Share of each coil, estimated together with the causes that the diagnosis named.
    """

    errors: ErrorMetrics
    diagnosis: Diagnosis
    shares: Mapping[str, Share]

    @property
    def is_coupled(self) -> bool:
        """Whether `neighbour_coil` is among the named causes, or among those that cannot be told from them."""
        causes = [
            cause
            for named in self.diagnosis.causes
            for cause in (named.cause, *(alternative.cause for alternative in named.alternatives))
        ]
        return any(cause.name == COUPLING.name for cause in causes)

    def words(self) -> str:
        """The finding in one sentence per coil."""
        head = "coils couple" if self.is_coupled else "no coupling found"
        bounds = [
            f"{coil} carries {100 * share.share:+.2f} ± {100 * share.sd:.2f} % of its neighbours' current "
            f"(at most {100 * share.largest:.2f} %, {1e6 * share.most_T:.1f} µT)"
            for coil, share in self.shares.items()
        ]
        return f"{head}: {'; '.join(bounds)}"


def superposition(
    system: System, session: Session, *, seed: int = 0, on_stage: Callable[[str], None] | None = None
) -> Superposition:
    """Test whether separately calibrated coils add up.

    Args:
        system: Calibrations whose rigs describe all coils, each made with its own coil on.
        session: Readings of the same rig with several coils on. Vary the signs of the currents: at a constant ratio, coupling looks like a
            wrong current and the bounds are wide.
        seed, on_stage: As in `diagnose`.
    Returns: Errors of the plain sum, the diagnosis, and each coil's share of its neighbours' currents.
    Raises:
        InvalidInput: A calibration is of another rig, or no reading has two coils on.
    References: Osinde et al., eq 14-17.
    """
    several = (session.observations.current_A != 0.0).sum(dim=1) > 1
    if not bool(several.any()):
        raise InvalidInput(
            f"readings must have two coils on at once to test superposition ({session.source})"
        )
    calibrations = {id(calibration): calibration for calibration in system.calibrations.values()}.values()
    for calibration in calibrations:
        session.check_rig(calibration.rig)
    observations = joined([*(calibration.observations for calibration in calibrations), session.observations])
    joint_session = Session(session.rig, observations, f"calibrations and {session.source}")
    diagnosis = diagnose(joint_session, seed=seed, on_stage=on_stage)
    checked = session.observations.rows(several)
    measured_T, predicted_T = checked.field_sensor_T, predicted_readings_T(system, session, checked)
    return Superposition(
        error_metrics(measured_T.numpy(), predicted_T.numpy()), diagnosis, _shares(diagnosis.fits.final)
    )


def predicted_readings_T(
    system: System, session: Session, observations: Observations
) -> Float[Tensor, "reading 3"]:
    """Readings of each sensor, as the first calibration knows it, if the separate calibrations add up."""
    first = next(iter(system.calibrations.values()))
    # Its rig has what a calibration frees by itself, such as the zeros of the sensors.
    rig, best = first.rig, first.best_values()
    values = {name: best.get(name, value) for name, value in nominal_tensors(rig).items()}
    model = MeasurementModel.unruled(rig, observations)
    pose_rows = torch.arange(len(model.sensor))
    world_from_sensor = model.world_from_sensor(pose_rows, values)
    points_m = world_from_sensor.translation_m.expand(len(pose_rows), 3)[model.pose_row]
    system_field = system.at(points_m, observations.motion)
    order = [[coil.name for coil in session.rig.coils].index(name) for name in system.coils]
    currents_A = observations.current_A[:, order]
    driven_T = (system_field.actuation(has_gradient=False) @ currents_A[..., None])[..., 0]
    field_T = system_field.field_T(torch.zeros(len(order), dtype=torch.float64)) + driven_T
    at_sensor_T = world_from_sensor.rows(model.pose_row).unrotate(field_T)
    shown_T: Tensor = model.shown_T(values, at_sensor_T)
    return shown_T.expand(len(observations), 3)


def joined(sessions: list[Observations]) -> Observations:
    """Sessions of one rig in a row as one; a temperature is kept if all sessions have it."""
    in_a_row, end_s = list[Observations](), 0.0
    for session in sessions:
        time_s = session.time_s - session.time_s.min() + end_s
        end_s = float(time_s.max()) + GAP_S
        plain = replace(
            session.alone, time_s=time_s, current_measured_A=None, recorded_segment=None, line=None
        )
        in_a_row.append(plain)
    return reduce(Observations.followed_by, in_a_row)


def _shares(fit: Fit) -> dict[str, Share]:
    """Share of every coil, all free at once together with the causes that were named."""
    rig, observations = fit.rig, fit.observations
    causes = {place: Cause(COUPLING.name, place) for place in COUPLING.places(rig)}
    for cause in causes.values():
        if cause not in rig.effects:
            rig = with_effect(rig, cause, observations, {})
    model = fit.posterior.model
    coupled = fit_rig(rig, observations, fit.start_with(rig), model.rules)
    shares = {}
    for coil, cause in causes.items():
        name = f"{cause.label}.share"
        share, sd = float(coupled.values[name]), coupled.value_sd(name)
        far_end = math.copysign(abs(share) + TWO_SIDED_95 * sd, share)
        with torch.no_grad():
            bound_T, none_T = (
                coupled.posterior.model.predict(
                    {**coupled.values, name: torch.tensor(value, dtype=torch.float64)}
                )
                for value in (far_end, 0.0)
            )
        shares[coil] = Share(share, sd, float((bound_T - none_T).norm(dim=-1).max()))
    return shares
