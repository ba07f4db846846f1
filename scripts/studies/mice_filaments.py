"""Effect of superconducting filaments on the maps of a magnet: all causes fitted at once, without the filaments and with them.

`diagnose` adds one cause after another. Here all causes of the probes are free from the start, the steel plate is known, and the only
question is whether the windings are magnetised. `make mice-filaments` runs it; it needs the folder named by COILCAL_DATA.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

import matplotlib.pyplot as plt
import torch

from estimator import load_rig
from estimator.diagnosis import effort
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.confirmed import answer
from estimator.diagnosis.mixture.correcting import corrected
from estimator.diagnosis.mixture.numbers import Numbers
from estimator.diagnosis.validation import improvement_of
from estimator.diagnosis.widening import Widening
from estimator.effects.attach import with_effect
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.readings.split import block_split, thinned
from estimator.rig.rig import Cause, Rig
from scripts.studies.diagnose_real import MICE, against_prior, session_of, with_known

PLATE = Path(__file__).resolve().parents[2] / "docs/studies/mice_plate/pierced_plate[room]"
OF_PROBES = ("sensor_misplaced", "axis_gain", "cross_axis", "sensor_offset", "element_displacement")
MAPS = ("mice-run05", "mice-run07")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    known_names = [data_set.name for data_set in MICE]
    parser.add_argument(
        "names", nargs="*", help=f"of {', '.join(known_names)}; by default run05 (M2) and run07 (M1)"
    )
    parser.add_argument(
        "--readings", type=int, default=900, help="number of readings to fit, drawn from four blocks in five"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--correct", action="store_true", help="correct what is left, as a diagnosis does")
    parser.add_argument("--out", type=Path, default=Path("out/mice_filaments"), help="folder for the picture")
    options = parser.parse_args()
    for name in set(options.names) - set(known_names):
        sys.exit(f"mice_filaments: names must be of {', '.join(known_names)}; received {name}")
    data = os.environ.get("COILCAL_DATA")
    if not data:
        sys.exit("mice_filaments: COILCAL_DATA must name the folder with the measured maps; it is not set")
    options.out.mkdir(parents=True, exist_ok=True)
    draw_without_current(Path(data), options.out / "without_current.png")
    torch.set_num_threads(1)
    for data_set in MICE:
        if data_set.name not in (options.names or MAPS):
            continue
        session = with_known(session_of(data_set, Path(data)), str(PLATE))
        split = session.observations.with_validation(block_split(session.observations, 0.2, options.seed))
        seen, unseen = (
            thinned(part, options.readings, options.seed) for part in (split.calibration, split.validation)
        )
        print(f"\n{data_set.name}: {len(seen)} readings fitted, {len(unseen)} of other blocks kept out")
        rig = with_all(
            session.rig, seen, [Cause(name, s.name) for name in OF_PROBES for s in session.rig.sensors]
        )
        before = fitted("the probes' causes and a background", rig, seen, unseen, None)
        wider = with_all(rig, seen, [Cause("filament_magnetisation", coil.name) for coil in rig.coils])
        after = fitted("and the filaments of all windings", wider, seen, unseen, before)
        print(f"  log evidence {after.log_evidence - before.log_evidence:+.0f}")
        for name, value in after.values.items():
            if name.startswith("filament_magnetisation"):
                print(f"    {name:45} {float(value):8.4f} +- {after.value_sd(name):.4f}")
        if options.correct:
            show_corrected(after, unseen, options.seed)


def with_all(rig: Rig, seen: Observations, causes: list[Cause]) -> Rig:
    """The rig with the causes and a background field free, starting at their nulls."""
    for cause in [*causes, Cause("background_field", "room")]:
        if cause not in rig.effects:
            rig = with_effect(rig, cause, seen, {})
    return rig


def fitted(words: str, rig: Rig, seen: Observations, unseen: Observations, start: Fit | None) -> Fit:
    begin = time.perf_counter()
    rules = MeasurementModel.build(rig, seen).rules
    values = {} if start is None else start.start_with(rig)
    fit = fit_rig(rig, seen, values, rules, tolerance=effort.ROUGH_TOLERANCE)
    rms = " and ".join(f"{1e6 * vector_rms_T(fit, part):.1f} uT" for part in (seen, unseen))
    print(f"  {words}: vector rms {rms} of unseen readings ({time.perf_counter() - begin:.0f} s)", flush=True)
    print(f"    coils against their drawing, in prior widths: {against_prior(fit)}", flush=True)
    return fit


def show_corrected(fit: Fit, unseen: Observations, seed: int) -> None:
    """What corrections do beside all causes, to unseen readings and the share of them inside 90 % intervals."""
    begin = time.process_time()
    found = answer(fit, Limits(), seed)
    correction = corrected(found, fit, fit, Limits())
    if correction.is_taken:
        numbers = Numbers.of(found)
        widening = Widening.of(
            correction.fit, correction.final, numbers.names, numbers.about(correction.final)
        )
        gain = improvement_of(fit, correction.final, unseen, widening.covariance)
        correction = correction.judged_by(gain)
    print(
        f"  {correction.words(lambda cause: cause.label)} ({time.process_time() - begin:.0f} s of a processor)"
    )
    if (gain := correction.gain) is not None:
        for words, scores in (("without", gain.before), ("with", gain.after)):
            error_uT = 1e6 * scores.errors.vector_T
            print(
                f"    {words} it: unseen {error_uT:.1f} uT, coverage of 90 % intervals {scores.coverage90:.1%}"
            )


def vector_rms_T(fit: Fit, observations: Observations) -> float:
    model = MeasurementModel.build(fit.rig, observations)
    with torch.no_grad():
        error_T = model.predict(fit.values) - observations.field_sensor_T
    return float(error_T.square().sum(-1).mean().sqrt())


def draw_without_current(data: Path, file: Path) -> None:
    """Field along the axis in run01 less the mean of each probe, with the positions of the windings."""
    session = session_of(next(data_set for data_set in MICE if data_set.name == "mice-run01"), data)
    observations, nominal = session.observations, session.rig.nominal_values()
    height_m = observations.motion["mapper"][:, 2]
    axial_mT = 1e3 * observations.field_sensor_T[:, 2]
    figure, axes = plt.subplots(figsize=(9.0, 3.6), layout="constrained")
    for coil in session.rig.coils:
        front_m = nominal[f"{coil.name}.world_from_coil.z_m"]
        length_m = nominal[f"{coil.name}.axial_pitch_m"] * nominal[f"{coil.name}.axial_loops"]
        axes.axvspan(front_m - length_m, front_m, color="0.9")
        axes.text(front_m - 0.5 * length_m, 0.72, coil.name, ha="center")
    plate_m = load_rig(PLATE.parent / "rig_extended.yaml").nominal_values()["pierced_plate[room].z_m"]
    axes.axvline(plate_m, color="0.5", ls="--", lw=1)
    axes.text(plate_m, 0.72, "plate ", ha="right")
    for i, sensor in enumerate(session.rig.sensors):
        is_own = observations.sensor == i
        axes.plot(
            height_m[is_own],
            axial_mT[is_own] - axial_mT[is_own].mean(),
            ".-",
            lw=0.5,
            ms=4,
            label=sensor.name,
        )
    axes.set(xlabel="along the magnet, z / m", ylabel="axial field / mT", ylim=(-0.65, 0.8))
    axes.set_title("No current: remanent field of the five windings in six probes (grey: windings)")
    axes.legend(ncols=6, fontsize="small", loc="lower center")
    figure.savefig(file, dpi=90)


if __name__ == "__main__":
    main()
