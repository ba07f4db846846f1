"""A twin of the paper's experiment (Tables 8 to 10, Figs 12 and 13): the effect of eq 13, taken literally, on a calibration.

`python -m scripts.paper.experiment_twin` runs it. The paper's readings are not published: the twin is a hypothesis about what they would
show. The true field is the vector sum of magpylib's loops; the arm misses its targets as a UR3 may, and the sensor is as noisy as a THM1176
(seed 3). The readings are fitted with the literal sum, with the right sum, and with the extension of the literal sum that `diagnose` finds
without being told.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import torch

from estimator import Diagnosis, Session, diagnose, load_plan
from estimator.diagnosis.figures import pictures
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.metrics import error_metrics
from estimator.readings.observations import Observations
from estimator.readings.plan import observations_of
from estimator.reporting.numbers import displays, with_sd
from estimator.reporting.plots import predicted_against_measured
from estimator.rig_files.read import rig_from_text
from scripts.paper.tables import CURRENT_A, NOT_AT_HAND, table
from tests.independent.readings import perfect_readings_T

ROOT = Path(__file__).resolve().parents[2]
SEED = 3
# One sigma of each axis: the UR3's data sheet says +-0.1 mm, which in ISO 9283 means three sigma.
REPEATABILITY_M = 0.1e-3 / 3.0
# Scale and shear of the arm's axes, one sigma: our choice, 0.1 mm over 50 mm; not in the data sheet.
DISTORTION = 2e-3
NOISE_T = 0.1e-3  # THM1176, averaged over 100 samples: 0.06 to 0.13 mT in recordings


def experiment(rig_text: str) -> Session:
    """The record of the laboratory: commanded displacements and measured fields."""
    rig = rig_from_text(rig_text, "configs/paper_twin.yaml")
    truth = json.loads((ROOT / "configs/truth/paper_twin.json").read_text(encoding="utf-8"))
    plan = load_plan(ROOT / "configs/plans/paper_grid.yaml", rig)
    planned = observations_of(plan, rig, np.random.default_rng(0))
    commanded_m = planned.motion["arm1"][:, :3].numpy()
    rng = np.random.default_rng(SEED)
    reached_m = commanded_m @ (np.eye(3) + DISTORTION * rng.normal(size=(3, 3))).T
    reached_m = reached_m + REPEATABILITY_M * rng.normal(size=reached_m.shape)
    field_T = perfect_readings_T(truth, reached_m, CURRENT_A)
    measured_T = field_T + NOISE_T * rng.normal(size=field_T.shape)
    return Session(rig, planned.with_field(torch.from_numpy(measured_T)), source="twin", truth=truth)


def parameters(session: Session, fits: dict[str, Fit]) -> str:
    """Table 8."""
    rows = []
    for name, show in displays(list(session.truth)).items():
        values = (float(session.rig.parameters[name].value), session.truth[name])
        estimates = (
            with_sd(show.factor * float(fit.values[name]), show.factor * fit.value_sd(name))
            for fit in fits.values()
        )
        rows.append((show.label, NOT_AT_HAND, *(f"{show.factor * value:g}" for value in values), *estimates))
    title = "Table 8: parameters, with one standard deviation"
    return table(title, ("parameter", "paper", "start", "truth", *fits), rows)


def residuals(session: Session, fits: dict[str, Fit]) -> str:
    """Tables 9 and 10: residuals of each model, for the readings it was fitted to and for others."""
    rows = []
    parts = {
        "5 x 5 x 5": session.observations.calibration,
        "7 x 7 x 7, not fitted": session.observations.validation,
    }
    for grid, part in parts.items():
        for words, fit in fits.items():
            metrics = error_metrics(part.field_sensor_T.numpy(), predicted_T(fit, part))
            sizes = (
                f"{1e3 * size_T:.3f}" for size_T in (metrics.paper_metric_T, metrics.vector_T, metrics.max_T)
            )
            shares = (f"{100 * metrics.relative:.1f} %", f"{1e3 * metrics.angular_deviation_rad:.0f}")
            rows.append((f"{grid}, {words}", NOT_AT_HAND, *sizes, *shares))
    sizes = ("paper's metric (mT)", "vector rms (mT)", "largest (mT)")
    title = (
        "Tables 9 and 10: residuals of readings with 0.1 mT of noise in each component (0.173 mT vector rms)"
    )
    return table(title, ("readings and model", "paper", *sizes, "relative", "angle (mrad)"), rows)


def predicted_T(fit: Fit, part: Observations) -> np.ndarray:
    """Prediction of a fitted model for readings, in tesla."""
    with torch.no_grad():
        return MeasurementModel.build(fit.rig, part).predict(fit.values).numpy()


def verdict(diagnosis: Diagnosis) -> str:
    """The verdict, its causes, and the improvement on readings that were not fitted."""
    lines = [f"diagnose, not told: {diagnosis.verdict}"]
    for cause in diagnosis.sized_causes:
        rivals = zip(cause.alternative_names, cause.alternatives, strict=True)
        others = ", ".join(f"{name} {rival.probability:.2g}" for name, rival in rivals) or "none"
        lines.append(f"- {cause.name}: log evidence {cause.log_bayes_factor:+.0f}, alternatives: {others}")
        lines += [f"  {key} = {v.median:.4f} +- {v.sd:.4f}" for key, v in cause.quantities.items()]
    assert diagnosis.improvement is not None
    before, after = diagnosis.improvement.before, diagnosis.improvement.after
    lines.append(
        f"- improvement on readings not used for fitting: vector rms {1e3 * before.errors.vector_T:.3f} -> "
        f"{1e3 * after.errors.vector_T:.3f} mT, log predictive density {diagnosis.improvement.elpd_difference:+.0f} +- "
        f"{diagnosis.improvement.elpd_se:.0f}, "
        f"90 % intervals hold {100 * before.coverage90:.0f} -> {100 * after.coverage90:.0f} % of the components"
    )
    return "\n".join((*lines, ""))


def study(out: Path) -> str:
    """Tables 8 to 10, the verdict, and the figures as files."""
    out.mkdir(parents=True, exist_ok=True)
    printed = (ROOT / "configs/paper_twin.yaml").read_text(encoding="utf-8")
    session = experiment(printed)
    diagnosis = diagnose(session, seed=1)
    right = rig_from_text(printed.replace("field_sum: spherical_components", "field_sum: vectors"))
    fitted = session.observations.calibration
    rules = MeasurementModel.build(right, fitted).rules
    fits = {
        "literal sum": diagnosis.fits.plain,
        "extended by diagnose": diagnosis.fits.extended,
        "right sum": fit_rig(right, fitted, {}, rules, more_starts=3),
    }
    for name, title in {
        "residual": "Residual around coil1, before and after",
        "evidence": "Hypotheses, step 1",
    }.items():
        drawn = next(picture.figure for picture in pictures(diagnosis) if picture.title == title)
        drawn.savefig(out / f"twin_{name}.png", dpi=90, bbox_inches="tight")
    for name, words in {"literal": "literal sum", "extended": "extended by diagnose"}.items():
        measured_T = fitted.field_sensor_T.numpy()
        ax = predicted_against_measured(
            measured_T, predicted_T(fits[words], fitted), NOISE_T, title=f"twin, {words}"
        )
        ax.figure.savefig(out / f"twin_predicted_{name}.png", dpi=90, bbox_inches="tight")
    return "\n".join((parameters(session, fits), residuals(session, fits), verdict(diagnosis)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "out/paper")
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(study(options.out))


if __name__ == "__main__":
    main()
