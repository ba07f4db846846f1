"""Simulated sessions: perfect readings of a known truth and of causes that are hidden in it, then noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from estimator.effects import effect_of
from estimator.effects.stages import NoiseEffect, RecordEffect
from estimator.effects.use import uses_of
from estimator.errors import InvalidInput
from estimator.model.hide import cause_of, full_names, with_hidden, with_truth
from estimator.model.measurement_model import MeasurementModel
from estimator.model.nominal import NominalPrediction
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan, observations_of
from estimator.readings.segments import segments_in_turn
from estimator.rig.coordinates import Coordinates, nominal_tensors
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

MOST_DRAWS = 100
TOLERANCE = 1e-10


def draw_truth(rig: Rig, seed: int) -> dict[str, float]:
    """Values of the free parameters drawn from their priors; loop counts as whole numbers, windings that leave a bore.

    Raises:
        InvalidInput: The priors allow next to no possible rig.
    Examples:
        >>> from estimator.rig_files.read import load_rig
        >>> truth = draw_truth(load_rig("configs/paper_simulation.yaml"), seed=1)
        >>> truth["coil1.axial_loops"] == round(truth["coil1.axial_loops"])
        True
    """
    coordinates = Coordinates(rig, integer_counts=True)
    rng = np.random.default_rng(seed)
    for _ in range(MOST_DRAWS):
        values = coordinates.values(coordinates.sample_prior(rng, 1)[0])
        truth = {name: float(values[name]) for name in coordinates.names}
        if rig.with_values(truth).broken_rule() is None:
            return truth
    raise InvalidInput(
        f"priors of rig {rig.name!r} must allow windings that leave a bore; {MOST_DRAWS} draws have none"
    )


def simulate(
    rig: Rig,
    plan: Plan,
    truth: Mapping[str, float],
    seed: int,
    hidden: Mapping[str, float] | None = None,
    n_segments: int = 1,
) -> Observations:
    """Readings that a plan gives at a truth, with the noise of the truth.

    Args:
        rig: Names and fixed values.
        plan: Poses and currents.
        truth: Values that replace the rig's nominal ones; `<sensor>.noise_T` is the noise added, 0 allowed.
        seed: Of order and noise.
        hidden: Causes that the rig knows nothing of, such as `{"axis_gain[hall].x": 0.01}` (see `with_hidden`).
        n_segments: Parts of the session, one after the other, before each of which things were set up anew.
    Raises:
        InvalidInput: The truth names an unknown parameter, is no possible rig, or puts a sensor inside a winding; or with a hidden cause a
            reading is no finite number.
    """
    real = with_truth(rig, truth)
    rng = np.random.default_rng(seed)
    observations = observations_of(plan, rig, rng)
    if n_segments > 1:
        observations = replace(
            observations, recorded_segment=segments_in_turn(observations.time_s, n_segments)
        )
    real = with_hidden(real, observations, hidden or {})
    model = MeasurementModel.build(real, observations, tolerance=TOLERANCE)
    field_T = model.predict(nominal_tensors(real))
    if hidden:
        _check_finite(field_T, observations, hidden)
    return observations.with_field(field_T + _errors_T(model, rng))


def _check_finite(
    field_T: Float[Tensor, "reading 3"], observations: Observations, hidden: Mapping[str, float]
) -> None:
    """Refuse causes that make something else than numbers of a field; in a file these readings would count as missing."""
    for i in (~field_T.isfinite().all(-1)).nonzero().flatten().tolist()[:1]:
        raise InvalidInput(
            f"readings with {', '.join(hidden)} must be finite, also where there is no current or no field; received {field_T[i].tolist()} "
            f"for reading {i + 1}, at {observations.current_A[i].tolist()} A"
        )


def idle_causes(rig: Rig, observations: Observations, hidden: Mapping[str, float]) -> list[str]:
    """Hidden causes that change no reading of a session, such as a coil's loss per kelvin where no thermometer is read.

    Those without size, and those that lie in the noise, do not count.

    Args:
        rig: The true rig without them.
        observations: Poses, currents and times of the session.
        hidden: See `with_hidden`.
    """
    idle = []
    for cause in dict.fromkeys(cause_of(text, rig) for text in hidden):
        sizes = {text: value for text, value in hidden.items() if cause_of(text, rig) == cause}
        if isinstance(effect_of(cause.name), NoiseEffect) or not any(sizes.values()):
            continue
        plain_T, changed_T = (
            perfect_readings(each, observations) for each in (rig, with_hidden(rig, observations, sizes))
        )
        if torch.equal(plain_T, changed_T):
            idle += list(full_names(rig, sizes))
    return idle


def perfect_readings(
    rig: Rig, observations: Observations, tolerance: float = TOLERANCE
) -> Float[Tensor, "reading 3"]:
    """What perfect sensors would read at the rig's nominal values; summed to 1e-10 of |B|, far below any noise, or to another tolerance."""
    return MeasurementModel.build(rig, observations, tolerance).predict(nominal_tensors(rig))


def _errors_T(model: MeasurementModel, rng: np.random.Generator) -> Float[Tensor, "reading 3"]:
    """Errors of simulated readings: noise of the sensors as recorded, changed by the effects of noise."""
    values, rig = nominal_tensors(model.rig), model.rig
    noise_T = torch.stack([values[f"{sensor.name}.noise_T"] for sensor in rig.sensors])
    sigma_T = noise_T[model.circumstances.sensor, None].expand(-1, 3)
    error_T = torch.from_numpy(rng.normal(size=tuple(sigma_T.shape))) * sigma_T
    for record in uses_of(rig, RecordEffect):
        sigma_T, error_T = (
            record.effect.recorded_error_T(t, record.theta(values)) for t in (sigma_T, error_T)
        )
    prediction = NominalPrediction(model)
    for use in uses_of(rig, NoiseEffect):
        theta = use.theta(values)
        more_T = use.effect.disturbed_T(error_T, sigma_T, prediction, theta, use.place, rng)
        error_T = use.where_concerned(model.circumstances, more_T, error_T)
    return error_T
