"""Small calibration problems that every step of the inference is tried on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pytest
import torch

from estimator.effects.attach import with_effect
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.read import rig_from_text


@dataclass(frozen=True)
class Problem:
    """Readings of a known truth, and the posterior with real-valued and with whole-numbered counts."""

    rig: Rig
    observations: Observations
    truth: Mapping[str, float]
    real: LogPosterior
    whole: LogPosterior


def make_problem(
    coils: str,
    sensors: str = "{hall: {noise_uT: 20, carried_by: stage}}",
    truth: Mapping[str, float] | None = None,
    noise_T: float = 20e-6,
    positions_m: np.ndarray | None = None,
    seed: int = 0,
) -> Problem:
    """One reading of every sensor and with every coil alone at 1 A, at each position of a stage whose flange starts at the world's origin.

    Args:
        coils, sensors: Sections of the rig file, as YAML in braces.
        truth: What differs from the nominal values.
        noise_T: Noise of the readings, which may differ from that of the rig.
        positions_m: Positions of the stage; by default 16 in a box of 4 cm.
        seed: Seed of positions and noise.
    """
    rig = rig_from_text(
        "schema_version: 1\nname: problem\nmovers: {stage: {motion: pose}}\n"
        f"coils: {coils}\nsensors: {sensors}\n"
    )
    random = np.random.default_rng(seed)
    positions = random.uniform(-0.02, 0.02, (16, 3)) if positions_m is None else positions_m
    position, coil, sensor = (
        axis.ravel()
        for axis in np.meshgrid(*(np.arange(n) for n in (len(positions), len(rig.coils), len(rig.sensors))))
    )
    n = len(position)
    observations = Observations.of(
        torch.from_numpy(np.eye(len(rig.coils))[coil]),
        {"stage": torch.from_numpy(np.concatenate((positions[position], np.zeros((n, 3))), axis=1))},
        torch.zeros(n, 3, dtype=torch.float64),
        sensor=torch.from_numpy(sensor),
    )
    true_rig = rig.with_values(truth or {})
    true_values = {k: torch.tensor(v, dtype=torch.float64) for k, v in true_rig.nominal_values().items()}
    perfect = MeasurementModel.build(true_rig, observations, tolerance=1e-12).predict(true_values)
    observations = observations.with_field(perfect + torch.from_numpy(noise_T * random.normal(size=(n, 3))))
    model = MeasurementModel.build(rig, observations, tolerance=1e-10)
    return Problem(
        rig,
        observations,
        true_rig.nominal_values(),
        LogPosterior(Coordinates(rig), model, observations),
        LogPosterior(Coordinates(rig, integer_counts=True), model, observations),
    )


@pytest.fixture(scope="session")
def problem() -> Callable[..., Problem]:
    """`make_problem`."""
    return make_problem


@pytest.fixture(scope="session")
def winding_problem() -> Problem:
    """A 6 x 4 winding of which everything is free, the noise of the sensor too."""
    return make_problem(
        """{coil1: {
  radius_mm: {prior: {normal: {mean: 51, sd: 2, lower: 30}}},
  wire_radius_mm: {prior: {normal: {mean: 0.9, sd: 0.05, lower: 0.2}}},
  axial_loops: {prior: {normal: {mean: 7, sd: 1.5, lower: 1}}},
  radial_loops: {prior: {normal: {mean: 4, sd: 1, lower: 1}}},
  world_from_coil: {x_mm: {prior: {normal: {mean: 0, sd: 3}}}, z_mm: {prior: {normal: {mean: -35, sd: 3}}},
    tilt_x_deg: {prior: {normal: {mean: 0, sd: 2}}}, tilt_y_deg: {prior: {normal: {mean: 0, sd: 2}}}}}}""",
        "{hall: {carried_by: stage, noise_uT: {prior: {log_normal: {median: 0.1, relative_sd: 0.7}}}}}",
        {
            "coil1.radius_m": 0.0503,
            "coil1.wire_radius_m": 0.00093,
            "coil1.axial_loops": 6.0,
            "coil1.world_from_coil.x_m": 0.001,
            "coil1.world_from_coil.z_m": -0.0342,
            "coil1.world_from_coil.tilt_x_rad": 0.02,
        },
        noise_T=0.08e-6,
    )


@pytest.fixture(scope="session")
def linear_problem() -> Problem:
    """Readings that are linear in what is free, the gains of two currents: everything is known in closed form."""
    gain = "current_gain: {prior: {normal: {mean: 1, sd: 0.05}}}"
    return make_problem(
        f"""{{coil1: {{radius_mm: 50, wire_radius_mm: 1, axial_loops: 3, radial_loops: 2, {gain}, world_from_coil: {{z_mm: -40}}}},
  coil2: {{radius_mm: 40, wire_radius_mm: 1, axial_loops: 2, radial_loops: 2, {gain}, world_from_coil: {{x_mm: -70, ry_deg: 80}}}}}}""",
        "{hall: {noise_uT: 0.2, carried_by: stage}}",
        {"coil1.current_gain": 1.03, "coil2.current_gain": 0.94},
        noise_T=0.2e-6,
    )


@pytest.fixture(scope="session")
def counts_problem() -> Problem:
    """A 6 x 4 winding whose counts are free, with a gain that blurs the turns: half a dozen pairs of counts are plausible."""
    return make_problem(
        """{coil1: {radius_mm: 50, wire_radius_mm: 1.5,
  axial_loops: {prior: {normal: {mean: 6, sd: 2, lower: 1}}}, radial_loops: {prior: {normal: {mean: 4, sd: 1, lower: 1}}},
  current_gain: {prior: {normal: {mean: 1, sd: 0.05}}}, world_from_coil: {z_mm: {prior: {normal: {mean: -35, sd: 3}}}}}}""",
        "{hall: {noise_uT: 2, carried_by: stage}}",
        {"coil1.world_from_coil.z_m": -0.034},
        noise_T=2e-6,
    )


@dataclass(frozen=True)
class ExactCounts:
    """What the posterior of `counts_problem` really is."""

    probability: Mapping[tuple[int, int], float]
    gain_mean: float
    z_mean_m: float
    z_sd_m: float


@pytest.fixture(scope="session")
def exact_counts(counts_problem: Problem) -> ExactCounts:
    """By hand: the gain integrates in closed form, as readings are linear in it, the height on a grid, the counts by enumeration."""
    model, measured = counts_problem.real.model, counts_problem.observations.field_sensor_T.flatten()
    nominal = {
        k: torch.tensor(v, dtype=torch.float64) for k, v in counts_problem.rig.nominal_values().items()
    }
    z_m = torch.linspace(-0.042, -0.028, 281, dtype=torch.float64)
    sigma_T, gain_sd = 2e-6, 0.05
    log_mass, gain = {}, {}
    for axial in range(1, 17):
        for radial in range(1, 9):
            counts = {"coil1.axial_loops": axial, "coil1.radial_loops": radial}
            values = nominal | {k: torch.tensor(float(v), dtype=torch.float64) for k, v in counts.items()}
            per_gain = model.predict(values | {"coil1.world_from_coil.z_m": z_m}).flatten(-2)
            A = (per_gain**2).sum(-1) / sigma_T**2 + 1.0 / gain_sd**2
            b = (per_gain * measured).sum(-1) / sigma_T**2 + 1.0 / gain_sd**2
            log_prior = -0.5 * (((axial - 6) / 2) ** 2 + (radial - 4) ** 2 + ((z_m + 0.035) / 0.003) ** 2)
            log_mass[axial, radial] = 0.5 * b**2 / A - 0.5 * torch.log(A) + log_prior
            gain[axial, radial] = b / A
    mass = torch.stack(list(log_mass.values()))
    mass = torch.exp(mass - mass.max())
    mass = mass / mass.sum()
    z_mean = (mass * z_m).sum()
    return ExactCounts(
        dict(zip(log_mass, mass.sum(-1).tolist(), strict=True)),
        (mass * torch.stack(list(gain.values()))).sum().item(),
        z_mean.item(),
        (mass * (z_m - z_mean) ** 2).sum().sqrt().item(),
    )


def posterior_with(problem: Problem, *causes: Cause) -> LogPosterior:
    """Density of a problem whose rig also has some causes."""
    rig = problem.rig
    for cause in causes:
        rig = with_effect(rig, cause, problem.observations, {})
    model = MeasurementModel.build(rig, problem.observations)
    return LogPosterior(Coordinates(rig), model, problem.observations)
