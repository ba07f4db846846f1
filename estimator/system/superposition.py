"""Do separately calibrated coils add up? Readings with all coils on decide: coupling and leakage are looked for and bounded.

The readings of the calibrations, one coil on at a time, and those with all on are diagnosed as one session, so that nothing of what the
calibrations know is lost. `neighbour_coil` competes with every other cause there; a wrong flange_from_coil is among them (`mount_tilt`).
Whatever is found, each coil's share of its neighbours' currents is then estimated beside it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

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
from estimator.rig.rig import Cause
from estimator.store.session import Session
from estimator.system.system import System

BETWEEN_S = 60.0  # put between sessions whose clocks are not the same
TWO_SIDED_95 = 1.959964


@dataclass(frozen=True)
class Share:
    """What a coil carries of its neighbours' currents.

    Attributes:
        share: Of the summed current of the others; 0 where nothing couples.
        sd: Its standard deviation.
        most_T: Largest field at a reading that a share at the far end of its 95 % interval makes.
    """

    share: float
    sd: float
    most_T: float

    @property
    def largest(self) -> float:
        """Magnitude that the share exceeds with a probability of 5 % at most."""
        return abs(self.share) + TWO_SIDED_95 * self.sd


@dataclass(frozen=True)
class Superposition:
    """Whether coils that were calibrated one at a time add up.

    Attributes:
        errors: Of the sum of the separate calibrations, on the readings with several coils on; nothing is fitted to them.
        diagnosis: Of all readings together.
        shares: By coil, beside whatever the diagnosis named.
    """

    errors: ErrorMetrics
    diagnosis: Diagnosis
    shares: Mapping[str, Share]

    @property
    def is_coupled(self) -> bool:
        """Whether `neighbour_coil` is among the causes named, or among those that cannot be told from them."""
        named = [
            c
            for one in self.diagnosis.causes
            for c in (one.cause, *(other.cause for other in one.alternatives))
        ]
        return any(cause.name == COUPLING.name for cause in named)

    def words(self) -> str:
        """The finding in one sentence per coil."""
        head = "coils couple" if self.is_coupled else "no coupling found"
        bounds = [
            f"{coil} carries {100 * one.share:+.2f} ± {100 * one.sd:.2f} % of its neighbours' current "
            f"(at most {100 * one.largest:.2f} %, {1e6 * one.most_T:.1f} µT)"
            for coil, one in self.shares.items()
        ]
        return f"{head}: {'; '.join(bounds)}"


def superposition(
    system: System, session: Session, *, seed: int = 0, on_stage: Callable[[str], None] | None = None
) -> Superposition:
    """Test that separately calibrated coils add up.

    Args:
        system: Calibrations whose rigs describe all coils, each made with its own coil on.
        session: Readings of the same rig with several coils on. Where their currents keep one ratio, coupling and a wrong current look
            alike and the bounds are wide: vary the signs.
        seed, on_stage: As in `diagnose`.
    Returns: Errors of the plain sum, the diagnosis, and how much of its neighbours' currents each coil carries.
    Raises:
        InvalidInput: A calibration is of another rig, or no reading has two coils on.
    References: Osinde et al., eq 14-17.
    """
    several = (session.observations.current_A != 0.0).sum(dim=1) > 1
    if not bool(several.any()):
        raise InvalidInput(
            f"readings must have two coils on at once to test superposition ({session.source})"
        )
    calibrations = {id(one): one for one in system.calibrations.values()}.values()
    for calibration in calibrations:
        session.check_rig(calibration.rig)
    together = joined([*(one.observations for one in calibrations), session.observations])
    everything = Session(session.rig, together, f"calibrations and {session.source}")
    diagnosis = diagnose(everything, seed=seed, on_stage=on_stage)
    checked = session.observations.rows(several)
    measured_T, predicted_T = checked.field_sensor_T, predicted_readings_T(system, session, checked)
    return Superposition(
        error_metrics(measured_T.numpy(), predicted_T.numpy()), diagnosis, _shares(diagnosis.fits.final)
    )


def predicted_readings_T(
    system: System, session: Session, observations: Observations
) -> Float[Tensor, "reading 3"]:
    """What the sensors should read if the separate calibrations add up, in the frame of each sensor."""
    values = {name: torch.tensor(v, dtype=torch.float64) for name, v in session.rig.nominal_values().items()}
    for calibration in system.calibrations.values():
        best = calibration.best_values()
        values |= {name: best[name] for name in values if name in best}
    model = MeasurementModel.unruled(session.rig, observations)
    every_place = torch.arange(len(model.sensor))
    world_from_sensor = model.world_from_sensor(every_place, values)
    points_m = world_from_sensor.translation_m.expand(len(every_place), 3)[model.pose_row]
    here = system.at(points_m, observations.motion)
    order = [[coil.name for coil in session.rig.coils].index(name) for name in system.coils]
    currents_A = observations.current_A[:, order]
    driven_T = (here.actuation(has_gradient=False) @ currents_A[..., None])[..., 0]
    field_T = here.field_T(torch.zeros(len(order), dtype=torch.float64)) + driven_T
    return world_from_sensor.rows(model.pose_row).unrotate(field_T)


def joined(sessions: list[Observations]) -> Observations:
    """Sessions of one rig as one, each after the one before; temperatures only where all recorded them."""
    times_s, end_s = [], 0.0
    for one in sessions:
        times_s.append(one.time_s - one.time_s.min() + end_s)
        end_s = float(times_s[-1].max()) + BETWEEN_S
    recorded = set.intersection(*(set(one.temperature_C) for one in sessions))
    return Observations(
        torch.cat(times_s),
        torch.cat([one.sensor for one in sessions]),
        torch.cat([one.current_A for one in sessions]),
        {name: torch.cat([one.motion[name] for one in sessions]) for name in sessions[0].motion},
        torch.cat([one.field_sensor_T for one in sessions]),
        torch.cat([one.is_validation for one in sessions]),
        torch.cat([one.repeat for one in sessions]),
        {name: torch.cat([one.temperature_C[name] for one in sessions]) for name in sorted(recorded)},
    )


def _shares(fit: Fit) -> dict[str, Share]:
    """Share of every coil, all free at once beside the causes that were named."""
    rig, observations = fit.rig, fit.observations
    causes = {place: Cause(COUPLING.name, place) for place in COUPLING.places(rig)}
    for cause in causes.values():
        if cause not in rig.effects:
            rig = with_effect(rig, cause, observations, {})
    model = fit.posterior.model
    coupled = fit_rig(rig, observations, fit.start_with(rig), model.rules)
    found = {}
    for coil, cause in causes.items():
        name = f"{cause.label}.share"
        share, sd = float(coupled.values[name]), coupled.value_sd(name)
        far = math.copysign(abs(share) + TWO_SIDED_95 * sd, share)
        with torch.no_grad():
            bound_T, none_T = (
                coupled.posterior.model.predict(
                    {**coupled.values, name: torch.tensor(s, dtype=torch.float64)}
                )
                for s in (far, 0.0)
            )
        found[coil] = Share(share, sd, float((bound_T - none_T).norm(dim=-1).max()))
    return found
