"""Diagnoses of measured coils: the causes in order, the log evidence of each, and what remains unexplained.

`make diagnose-real` runs it; it needs the maps of public repositories in the folder named by COILCAL_DATA (see the README).
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

import torch

from estimator import diagnose, load_rig
from estimator.diagnosis import effort
from estimator.diagnosis.figures import pictures
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.report import diagnosis_report
from estimator.diagnosis.result import REPORT
from estimator.effects.attach import with_effect
from estimator.store.files import write_text
from estimator.store.importers import IMPORTERS
from estimator.store.session import Session
from scripts.studies.real_data import DATA_SETS, DataSet

PER_RUN = {"step_T"}  # may differ from run to run
OFF = {"M1": 0.0, "M2": 0.0, "E1": 0.0, "CC": 0.0, "E2": 0.0}
POWERED = {"run01": (), "run07": ("M1",), "run05": ("M2",), "run03": ("E1", "CC", "E2")}
MICE = tuple(
    DataSet(
        f"mice-{run}", "mice_ssu", "mice", f"mice-ssu-solenoids/{run}*.dat", OFF | dict.fromkeys(coils, 30.0)
    )
    for run, coils in POWERED.items()
)

MORE = (
    DataSet("maxwell-both-coils", "maxwell_pair", "plane_map", "maxwell-pair-plane-maps/u1_*.csv"),
    DataSet(
        "mri4all-gradient",  # the negative control: no circular loops
        "mri4all_gradient",
        "difference_scan",
        "mri4all-gradient-coils/*_[bg][0x].csv",
        {"coil1": 1.0, "coil2": -1.0},
    ),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="data sets; all by default")
    parser.add_argument("--out", type=Path, default=Path("out/diagnosis"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--most-causes", type=int, help="things that may be wrong at once")
    parser.add_argument(
        "--thin",
        type=int,
        default=effort.MOST_READINGS_SEARCHED,
        help="readings that causes are searched with",
    )
    parser.add_argument(
        "--carry",
        help="FOLDER/CAUSE: take a cause as known, with the values that an earlier run in FOLDER gave it; only the step of the "
        "room's field across a plate stays free",
    )
    parser.add_argument("--device", default="cpu", help="where it searches and corrects, such as cuda")
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    data = os.environ.get("COILCAL_DATA")
    if not data:
        sys.exit("diagnose_real: COILCAL_DATA must name the folder with the measured maps; it is not set")
    torch.set_num_threads(options.threads)
    data_sets = (*(data_set for data_set in DATA_SETS if data_set.importer != "mice"), *MORE, *MICE)
    for name in set(options.names) - {data_set.name for data_set in data_sets}:
        sys.exit(f"diagnose_real: names must be data sets of this study; received {name}")
    for data_set in data_sets:
        if not options.names or data_set.name in options.names:
            run(data_set, Path(data), options)


def run(data_set: DataSet, data: Path, options: argparse.Namespace) -> None:
    begin, out = time.perf_counter(), options.out
    session = session_of(data_set, data)
    print(f"\n{data_set.name}: {len(session.observations)} readings", flush=True)
    if options.carry:
        session = with_known(session, options.carry)

    def tell(words: str) -> None:
        print(f"  {time.perf_counter() - begin:5.0f} s  {words}", flush=True)

    diagnosis = diagnose(
        session,
        seed=options.seed,
        out=out / data_set.name,
        limits=Limits(options.most_causes),
        most_readings=options.thin,
        device=options.device,
        on_stage=tell,
    )
    tell("diagnosed; writing the report")
    write_text(
        out / data_set.name / REPORT,
        diagnosis_report(diagnosis, f"python -m scripts.studies.diagnose_real {data_set.name}"),
    )
    for picture in pictures(diagnosis):
        name = picture.title.lower().replace(",", "").replace(" ", "_")
        picture.figure.savefig(out / data_set.name / f"{name}.png", dpi=90, bbox_inches="tight")
    left = diagnosis.findings.answer.left
    print(
        f"  verdict: {diagnosis.verdict}; left: {left.rms_sigma:.2g} of the noise rms in {left.words}, "
        f"log evidence {left.log_bayes_factor:.3g}"
    )
    for stand_in in diagnosis.findings.stand_ins:
        print(f"  not sure enough to be stated: {diagnosis.label(stand_in)}")
    for cause in diagnosis.sized_causes:
        others = "".join(f", or {name}" for name in cause.alternative_names)
        print(f"  {cause.name} ({cause.probability:.0%}){others}")
        for key, p in cause.quantities.items():
            print(f"    {key:18} {p.median:12.4g} +- {p.sd:.1g} {p.unit}")
    if (improvement := diagnosis.improvement) is not None:
        for name, scores in (("before", improvement.before), ("after", improvement.after)):
            print(
                f"  {name}: {scores.errors.vector_T * 1e3:.3f} mT rms ({scores.errors.relative:.3%}), largest "
                f"{scores.errors.max_T * 1e3:.2f} mT, coverage of 90 % intervals {scores.coverage90:.1%}"
            )
        print(f"  log predictive density {improvement.elpd_difference:+.0f} +- {improvement.elpd_se:.0f}")
        moved = {name: round(value, 1) for name, value in improvement.moved_sd.items() if abs(value) > 2.0}
        print(f"  moved by more than two standard deviations: {moved}")
    for words, fit in (("before", diagnosis.fits.plain), ("after", diagnosis.fits.final)):
        print(f"  coils against their drawing, {words}: {against_prior(fit)}")


def session_of(data_set: DataSet, data: Path) -> Session:
    """The readings, with the free parameters of idle coils fixed."""
    rig = load_rig(Path(__file__).resolve().parents[2] / f"configs/{data_set.rig}.yaml")
    idle = [coil.name for coil in rig.coils if data_set.currents_A.get(coil.name) == 0.0]
    rig = rig.with_fixed(p.name for p in rig.free if p.name.partition(".")[0] in idle)
    return IMPORTERS[data_set.importer](sorted(data.glob(data_set.files)), rig, data_set.currents_A)


def with_known(session: Session, carry: str) -> Session:
    """The session with a cause of an earlier diagnosis in its rig, fixed at the values found there."""
    earlier, _, label = carry.rpartition("/")
    earlier_rig = load_rig(Path(earlier) / "rig_extended.yaml")
    cause = next((cause for cause in earlier_rig.effects if cause.label == label), None)
    if cause is None:
        sys.exit(f"--carry must name a cause of {earlier}/rig_extended.yaml; received {label}")
    values = {
        key.rpartition(".")[2]: value
        for key, value in earlier_rig.nominal_values().items()
        if key.startswith(f"{label}.")
    }
    rig = with_effect(session.rig, cause, session.observations, values)
    fixed = [f"{label}.{key}" for key in values if key not in PER_RUN]
    return replace(session, rig=rig.with_fixed(fixed))


def against_prior(fit: Fit) -> dict[str, float]:
    """Distance of the coils' free parameters from the centre of their priors, in standard deviations of the prior."""
    coils = {coil.name for coil in fit.rig.coils}
    of_coils = [p for p in fit.rig.free if p.name.partition(".")[0] in coils]
    return {
        p.name: round(p.prior.distance(float(fit.values[p.name])), 2) for p in of_coils if p.prior is not None
    }


if __name__ == "__main__":
    main()
