"""Calibrations of measured coils: residuals of the nominal geometry, of fitted pose and current, and of the posterior.

`make real` runs it; it needs the maps of public repositories in the folder named by COILCAL_DATA (see the README) and writes tables to
standard output and, per data set, a calibration with its report below --out.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch

from estimator import SamplerSettings, Session, block_split, calibrate, load_rig
from estimator.calibration.report import calibration_report
from estimator.inference.likelihood import LogPosterior
from estimator.inference.point_estimate import point_estimate
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.metrics import error_metrics
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from estimator.store.files import write_text
from estimator.store.importers import IMPORTERS

WINDING = ("radius_m", "wire_radius_m", "axial_pitch_m", "radial_pitch_m", "axial_loops", "radial_loops")


@dataclass(frozen=True)
class DataSet:
    name: str
    rig: str
    importer: str
    files: str
    currents_A: Mapping[str, float] = field(default_factory=dict)


DATA_SETS = (
    DataSet("mice-run07", "mice_ssu_m1", "mice", "mice-ssu-solenoids/run07*.dat"),
    DataSet(
        "goettingen-long",
        "goettingen_long",
        "axis_scan",
        "goettingen-axis-scans/HallLang.dat",
        {"coil1": 0.5},
    ),
    DataSet(
        "goettingen-thick",
        "goettingen_thick",
        "axis_scan",
        "goettingen-axis-scans/HallDick.dat",
        {"coil1": 0.5},
    ),
    DataSet(
        "goettingen-helmholtz",
        "goettingen_helmholtz",
        "axis_scan",
        "goettingen-axis-scans/HallHelm.dat",
        {"coil1": 0.25, "coil2": 0.25},
    ),
    DataSet("maxwell-one-coil", "maxwell_pair", "plane_map", "maxwell-pair-plane-maps/u1_1_9_u2_0_r*.csv"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="data sets; all by default")
    parser.add_argument("--out", type=Path, default=Path("out/real"))
    parser.add_argument("--ess", type=float, default=1000.0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    data = os.environ.get("COILCAL_DATA")
    if not data:
        sys.exit("real_data: COILCAL_DATA must name the folder with the measured maps; it is not set")
    torch.set_num_threads(1)
    for data_set in DATA_SETS:
        if not options.names or data_set.name in options.names:
            run(data_set, Path(data), options.out / data_set.name, options.ess, options.seed)


def run(data_set: DataSet, data: Path, out: Path, ess: float, seed: int) -> None:
    begin = time.perf_counter()
    rig = load_rig(Path(__file__).resolve().parents[2] / f"configs/{data_set.rig}.yaml")
    session = IMPORTERS[data_set.importer](sorted(data.glob(data_set.files)), rig, data_set.currents_A)
    observations = session.observations
    split = block_split(observations, 0.2, seed)
    session = replace(session, observations=observations.with_validation(split))
    print(f"\n{data_set.name}: {len(observations)} readings, {int(split.sum())} of them for validation")
    show("nominal", session, rig, values(rig.nominal_values()))
    winding = [p.name for p in rig.free if p.name.endswith(WINDING)]
    winding_fixed = rig.with_fixed(winding)
    show("pose, current and noise", session, winding_fixed, fit(session, winding_fixed, seed))
    settings = SamplerSettings(target_ess=ess)
    calibration = calibrate(session, out=out, overwrite=True, seed=seed, settings=settings)
    show("posterior, winding too", session, rig, values(calibration.best), by_sensor=True)
    summary = calibration.summary()
    write_text(
        out / "report.html",
        calibration_report(calibration, f"python -m scripts.studies.real_data {data_set.name}"),
    )
    print(f"  {'parameter':36} {'median':>12} {'sd':>10}  {'prior':>22}")
    for parameter in rig.free:
        numbers, prior = summary["parameters"][parameter.name], parameter.prior
        assert prior is not None
        print(
            f"  {parameter.name:36} {numbers['median']:12.6g} {numbers['sd']:10.2g}  {prior.centre:12.6g} +- {prior.sd:.2g}"
        )
    for name, distance in summary["prior_tension"].items():
        print(f"  {name} lies {distance:+.1f} prior standard deviations from the centre of its prior")
    for direction in summary["undetermined"]:
        print(f"  not determined by the data: {direction['words']}")
    state = "converged" if summary["is_converged"] else "NOT CONVERGED"
    print(
        f"  coverage of 90 % intervals: {summary['coverage90']}; sampling {state}: {summary['sampling']}; "
        f"{time.perf_counter() - begin:.0f} s"
    )


def fit(session: Session, rig: Rig, seed: int) -> dict[str, torch.Tensor]:
    calibration = session.observations.calibration
    coordinates = Coordinates(rig)
    posterior = LogPosterior(coordinates, MeasurementModel.build(rig, calibration), calibration)
    return coordinates.values(point_estimate(posterior, calibration, seed).vector)


def values(numbers: dict[str, float]) -> dict[str, torch.Tensor]:
    return {name: torch.tensor(value, dtype=torch.float64) for name, value in numbers.items()}


def show(
    label: str, session: Session, rig: Rig, values: dict[str, torch.Tensor], by_sensor: bool = False
) -> None:
    observations = session.observations
    measured = observations.field_sensor_T.numpy()
    predicted = MeasurementModel.build(rig, observations).predict(values).numpy()
    is_validation = observations.is_validation.numpy()
    parts = {"all": np.ones_like(is_validation), "calibration": ~is_validation, "validation": is_validation}
    text = []
    for role, is_part in parts.items():
        if is_part.any():
            metrics = error_metrics(measured[is_part], predicted[is_part])
            text.append(f"{role} {metrics.vector_T * 1e3:.4f} mT ({metrics.relative:.2%})")
    print(f"  {label:24} vector rms: {', '.join(text)}")
    if by_sensor and len(rig.sensors) > 1:
        for i, sensor in enumerate(rig.sensors):
            is_own = observations.sensor.numpy() == i
            metrics = error_metrics(measured[is_own], predicted[is_own])
            print(
                f"    {sensor.name}: {metrics.vector_T * 1e3:.4f} mT ({metrics.relative:.2%}), largest {metrics.max_T * 1e3:.2f} mT"
            )


if __name__ == "__main__":
    main()
