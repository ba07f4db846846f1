"""Two arms calibrated one coil at a time, then both on: errors and coverage of the sum, detection of a leak, currents for a wanted field.

The readings come from magpylib and NumPy (`tests/independent`), which share no code with coilcal. `make two-arms` runs it, in one or two
minutes a repeat.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np
import torch

from estimator import Session, System, calibrate, superposition
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from tests.independent.readings import displaced_coil_field_T

RIG = """
schema_version: 1
name: two coils on two arms
movers:
  arm1: {motion: displacement}
  arm2: {motion: displacement}
coils:
  coil1:
    carried_by: arm1
    radius_mm: &radius {prior: {normal: {mean: 51, sd: 1}}}
    wire_radius_mm: &wire_radius {prior: {normal: {mean: 0.49, sd: 0.01, lower: 0.2}}}
    axial_loops: &axial {prior: {normal: {mean: 48, sd: 1, lower: 1}}}
    radial_loops: &radial {prior: {normal: {mean: 25, sd: 1, lower: 1}}}
    world_from_coil0:
      {x_mm: &near {prior: {normal: {mean: 0, sd: 1}}}, y_mm: *near, z_mm: {prior: {normal: {mean: -60, sd: 2}}},
      tilt_x_deg: *near, tilt_y_deg: *near}
  coil2:
    carried_by: arm2
    radius_mm: *radius
    wire_radius_mm: *wire_radius
    axial_loops: *axial
    radial_loops: *radial
    world_from_coil0:
      {x_mm: {prior: {normal: {mean: 60, sd: 2}}}, y_mm: *near, z_mm: *near, tilt_x_deg: *near, tilt_y_deg: *near, ry_deg: -90}
sensors:
  hall: {noise_uT: 50}
"""
ARMS = {"coil1": "arm1", "coil2": "arm2"}
TURN_RAD = {"coil1": np.zeros(3), "coil2": np.array([0.0, -np.pi / 2.0, 0.0])}
NOISE_T, CURRENT_A, N_POSES, LEAK = 50e-6, 3.0, 60, 0.02
COUNTS = ("axial_loops", "radial_loops")


@dataclass(frozen=True)
class Outcome:
    """Result of one repeat.

    Attributes:
        error: Relative rms error of the sum of both calibrated coils at points where neither was measured.
        coverage: Share of true components inside their 90 % intervals at these points.
        steering: Relative rms difference between the wanted field and the true field of the computed currents.
        words: Finding on superposition, without and with a leak from coil1 into coil2.
        is_right: Whether the first finds no coupling, and the second finds that of coil2, its share within three standard deviations.
    """

    error: float
    coverage: float
    steering: float
    words: tuple[str, str]
    is_right: tuple[bool, bool]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=500)
    options = parser.parse_args()
    torch.set_num_threads(1)
    outcomes = []
    for seed in range(options.first_seed, options.first_seed + options.repeats):
        begin = time.perf_counter()
        outcomes.append(repeat := outcome(seed))
        print(
            f"seed {seed}: sum off by {repeat.error:.3%}, {repeat.coverage:.0%} of it inside 90 % intervals; currents miss the "
            f"wanted field by {repeat.steering:.3%} ({time.perf_counter() - begin:.0f} s)"
        )
        for words, is_right in zip(repeat.words, repeat.is_right, strict=True):
            print(f"  {'right' if is_right else 'WRONG'}: {words}", flush=True)
    n = len(outcomes)
    print(
        f"{n} pairs of arms: sum off by {np.median([repeat.error for repeat in outcomes]):.3%} in the median, "
        f"{np.mean([repeat.coverage for repeat in outcomes]):.1%} inside 90 % intervals; currents miss by "
        f"{np.median([repeat.steering for repeat in outcomes]):.3%}; no coupling reported where there is none in "
        f"{sum(repeat.is_right[0] for repeat in outcomes)} of {n}, a leak of {LEAK:.0%} found in "
        f"{sum(repeat.is_right[1] for repeat in outcomes)} of {n}"
    )


def outcome(seed: int) -> Outcome:
    """Calibrate each arm alone, and judge the sum by magpylib."""
    rng = np.random.default_rng(seed)
    rig = rig_from_text(RIG)
    truth = draw(rig, rng)
    calibrations = []
    for coil, current_A in zip(ARMS, np.diag([CURRENT_A, CURRENT_A]), strict=True):
        session = Session(rig, readings(truth, current_A[None], rng), f"{coil} on")
        other_coil_fixed = rig.with_fixed(p.name for p in rig.free if not p.name.startswith(coil))
        calibrations.append(calibrate(session, other_coil_fixed, seed=seed))
    system = System.of(*calibrations)
    points_m = rng.uniform(-0.015, 0.015, (40, 3))
    shift_m = {arm: rng.uniform(-0.015, 0.015, 3) for arm in ARMS.values()}
    motion = {arm: torch.tensor([*at_m, 0.0, 0.0, 0.0], dtype=torch.float64) for arm, at_m in shift_m.items()}
    system_field = system.at(torch.from_numpy(points_m), motion)
    per_ampere = np.stack([field_T(truth, coil, shift_m[arm], points_m) for coil, arm in ARMS.items()], -1)
    current_A = np.array([CURRENT_A, -0.7 * CURRENT_A])
    true_T = per_ampere @ current_A
    lower_T, upper_T = (
        end.numpy() for end in system_field.field_interval_T(torch.from_numpy(current_A), 0.9)
    )
    # Two coils reach a plane of fields at each point.
    wanted_T = per_ampere @ rng.uniform(-CURRENT_A, CURRENT_A, 2)
    steered_A = system_field.currents_for_field(torch.from_numpy(wanted_T)).numpy()
    made_T = (per_ampere @ steered_A[..., None])[..., 0]
    both_on = np.array([[CURRENT_A, CURRENT_A], [CURRENT_A, -CURRENT_A]])
    findings = [
        superposition(system, Session(rig, readings(truth, both_on, rng, leak), "both coils on"), seed=seed)
        for leak in (0.0, LEAK)
    ]
    share = findings[1].shares["coil2"]
    return Outcome(
        relative(system_field.field_T(torch.from_numpy(current_A)).numpy() - true_T, true_T),
        float(((lower_T <= true_T) & (true_T <= upper_T)).mean()),
        relative(made_T - wanted_T, wanted_T),
        (findings[0].words(), findings[1].words()),
        (
            not findings[0].is_coupled,
            findings[1].is_coupled and abs(share.share - LEAK) < 3.0 * share.sd,
        ),
    )


def draw(rig: Rig, rng: np.random.Generator) -> dict[str, float]:
    """A pair of coils within two standard deviations of the rig file, with whole loop counts."""
    truth = rig.nominal_values()
    for parameter in rig.free:
        assert parameter.prior is not None
        value = parameter.value + parameter.prior.sd * float(np.clip(rng.normal(), -2.0, 2.0))
        truth[parameter.name] = round(value) if parameter.name.endswith(COUNTS) else value
    return truth


def field_T(truth: dict[str, float], coil: str, shift_m: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """Field per ampere in the room, by magpylib."""
    return displaced_coil_field_T(truth, coil, TURN_RAD[coil], shift_m, points_m)


def readings(
    truth: dict[str, float], currents_A: np.ndarray, rng: np.random.Generator, leak: float = 0.0
) -> Observations:
    """Readings with both arms in random poses, at all currents in each; coil2 also carries a share of coil1's current."""
    shifts_m = rng.uniform(-0.02, 0.02, (N_POSES, 2, 3))
    shifts_m[..., 2] -= 0.01
    measured_T, origin_m = [], np.zeros((1, 3))
    for pose_m in shifts_m:
        per_ampere = [
            field_T(truth, coil, at_m, origin_m)[0] for coil, at_m in zip(ARMS, pose_m, strict=True)
        ]
        for commanded_A in currents_A:
            delivered_A = commanded_A + np.array([0.0, leak * commanded_A[0]])
            measured_T.append(delivered_A @ per_ampere + NOISE_T * rng.normal(size=3))
    each = len(currents_A)
    motion = {
        arm: torch.from_numpy(np.pad(shifts_m[:, i], ((0, 0), (0, 3)))).repeat_interleave(each, 0)
        for i, arm in enumerate(ARMS.values())
    }
    current_A = torch.from_numpy(np.tile(currents_A, (N_POSES, 1)))
    return Observations.of(current_A, motion, torch.from_numpy(np.array(measured_T)))


def relative(error_T: np.ndarray, true_T: np.ndarray) -> float:
    return float(np.sqrt((error_T**2).sum() / (true_T**2).sum()))


if __name__ == "__main__":
    main()
