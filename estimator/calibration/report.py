"""The page of one calibration: its values, how well they fit, and what the data leave open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from estimator.calibration.figures import pictures
from estimator.calibration.residual_groups import residual_groups
from estimator.calibration.result import Calibration
from estimator.calibration.sentences import sampling_words, verdict_sentences, warning_sentences
from estimator.reporting.numbers import Display, displays, microtesla, percent, size_with_unit, to_digit_of
from estimator.reporting.page import ReportPage, Table, render_report
from estimator.rig.bodies import EquivalentSourceCoil, UnwoundCoil
from estimator.rig.rig import Rig
from estimator.units import split_quotient


def calibration_report(calibration: Calibration, command: str) -> str:
    """HTML of one calibration, self-contained.

    Args:
        calibration: Made by `estimator.calibration.calibrate` or loaded from disk.
        command: The command that produced it, shown as provenance.
    """
    summary = calibration.summary()
    page = ReportPage(
        title=f"Calibration of {calibration.rig.name}",
        subtitle=f"{summary['session_source']}; readings recorded {summary['session_created']}",
        verdict=verdict_sentences(calibration),
        warnings=warning_sentences(summary),
        tables=_tables(calibration),
        figures=pictures(calibration),
        provenance={
            "command": command,
            "seed": str(summary["seed"]),
            "session": summary["session_hash"],
            "rig": summary["rig_hash"],
            "versions": ", ".join(f"{name} {v}" for name, v in summary["versions"].items()),
            "sampling": sampling_words(summary),
        },
    )
    return render_report(page)


def _tables(calibration: Calibration) -> list[Table]:
    summary = calibration.summary()
    amplitudes = [coil.amplitudes for coil in calibration.rig.unwound]
    by_degree = {name for of_coil in amplitudes for names in of_coil.values() for name in names}
    names = [name for name in summary["parameters"] if name not in by_degree]
    display = displays(names)
    truth = summary["truth"]
    header = [
        "parameter",
        "median ± sd",
        "90 % credible interval",
        "unit",
        "prior",
        *(["truth"] if truth else []),
    ]
    rows = []
    for name in names:
        numbers, show = summary["parameters"][name], display[name]
        parameter = calibration.rig.parameters.get(name)
        prior = parameter.prior if parameter is not None else None
        row = [
            split_quotient(name)[0],
            *_median_and_interval(numbers, show),
            show.unit or "1",
            show.with_sd(prior.centre, prior.sd) if prior else "derived",
        ]
        if truth:
            row.append(to_digit_of(0.0, truth[name] * show.factor) if name in truth else "—")
        rows.append(row)
    tables = [Table("Parameters", header, rows, "Medians and central 90 % intervals of the posterior.")]
    if determined := summary.get("amplitudes"):
        tables.append(_amplitude_table(calibration.rig, summary["parameters"], determined))
    if summary["loop_counts"]:
        counts = [
            [e["coil"], str(e["axial"]), str(e["radial"]), f"{e['probability']:.4f}"]
            for e in summary["loop_counts"][:10]
        ]
        tables.append(Table("Loop counts", ["coil", "axial", "radial", "probability"], counts))
    tables.append(_error_table(summary))
    tables.append(_group_table(calibration))
    if len(calibration.rig.sensors) > 1:
        tables.append(_sensor_table(summary))
    return tables


def _median_and_interval(numbers: Mapping[str, Any], show: Display) -> tuple[str, str]:
    """Median with standard deviation and 90 % interval; counts as whole numbers."""
    if not show.unit and all(float(value).is_integer() for value in (numbers["median"], *numbers["ci90"])):
        low, high = numbers["ci90"]
        return f"{numbers['median']:.0f} ± {numbers['sd']:.2g}", f"{low:.0f} to {high:.0f}"
    return show.with_sd(numbers["median"], numbers["sd"]), show.interval(numbers["ci90"], numbers["sd"])


def _amplitude_table(
    rig: Rig, parameters: Mapping[str, Any], determined: Mapping[str, Mapping[str, int]]
) -> Table:
    """Amplitudes of coils without a winding by degree; each one is in summary.json. Coils without current have only their priors."""
    rows = []
    for coil in rig.unwound:
        if not determined.get(coil.name, {}).get("determined"):
            continue
        for degree, names in coil.amplitudes.items():
            numbers = [parameters[name] for name in names if name in parameters]
            priors = [prior for name in names if (prior := rig.parameters[name].prior) is not None]
            if not numbers:
                continue
            sizes = [
                _rms([number["median"] for number in numbers]),
                _rms([number["sd"] for number in numbers]),
                _rms([prior.sd for prior in priors]),
            ]
            rows.append(
                [
                    coil.name,
                    str(degree) if coil.has_degrees else _sources_words(coil),
                    str(len(numbers)),
                    *(size_with_unit(s, "T/A", 3) for s in sizes),
                ]
            )
    header = ["coil", "degree", "amplitudes", "rms amplitude", "rms sd", "prior sd"]
    caption = "Each amplitude is in summary.json. Coils that carried no current are left out: of them only the priors are known."
    return Table("Amplitudes of coils without a winding", header, rows, caption)


def _sources_words(coil: UnwoundCoil) -> str:
    has_multipoles = isinstance(coil, EquivalentSourceCoil) and bool(coil.multipoles_m)
    return "charges and multipoles" if has_multipoles else "charges"


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _error_table(summary: Mapping[str, Any]) -> Table:
    rows = []
    for role in ("calibration", "validation"):
        for label, source in (("nominal", "rmse_nominal"), ("calibrated", "rmse")):
            metrics = summary[source][role]
            if metrics is None:
                continue
            angle = metrics["angular_deviation_rad"]
            rows.append(
                [
                    f"{label}, {role}",
                    microtesla(metrics["vector_T"]),
                    microtesla(metrics["component_T"]),
                    microtesla(metrics["paper_metric_T"]),
                    microtesla(metrics["max_T"]),
                    percent(metrics["relative"], 3),
                    f"{np.degrees(angle):.3f}°" if angle is not None else "—",
                ]
            )
    header = [
        "model and readings",
        "vector rms",
        "component rms",
        "paper's metric",
        "largest",
        "of rms field",
        "mean angle",
    ]
    return Table("Errors", header, rows, "The paper's metric is half the vector rms.")


def _group_table(calibration: Calibration) -> Table:
    rows = [
        [
            group.by,
            group.name,
            str(group.n_readings),
            f"{group.rms_sigma:.2f}",
            *("—" if mean is None else f"{mean:+.2f}".replace("-", "−") for mean in group.mean_sigma),
        ]
        for group in residual_groups(calibration)
    ]
    header = ["by", "group", "readings", "rms", "mean x", "mean y", "mean z"]
    caption = "In units of the noise: about 1, and means about 0, where the model holds. What stands out says where to look."
    return Table("Residuals by current, axis, height and sensor", header, rows, caption)


def _sensor_table(summary: Mapping[str, Any]) -> Table:
    rows = [
        [name, microtesla(metrics["vector_T"]), percent(metrics["relative"], 3)]
        for name, metrics in summary["rmse_by_sensor"]["calibration"].items()
    ]
    return Table("Errors by sensor", ["sensor", "vector rms", "of rms field"], rows)
