"""The page of one calibration: its values, how well they fit, and what the data leave open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from estimator.calibration.figures import pictures
from estimator.calibration.notes import told_by_data
from estimator.calibration.quality import condition, noise_rms_T
from estimator.calibration.residual_groups import residual_groups
from estimator.calibration.result import Calibration
from estimator.reporting.numbers import displays, percent, probability, size_with_unit, to_digit_of
from estimator.reporting.page import ReportPage, Table, render_report
from estimator.rig.bodies import EquivalentSourceCoil, HarmonicCoil, UnwoundCoil
from estimator.rig.rig import Rig
from estimator.units import split_quotient

HARDLY_NARROWED = 3.0  # data as wide as three priors narrow the interval by 5 %, which no reader sees


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
            "sampling": _sampling(summary),
        },
    )
    return render_report(page)


def verdict_sentences(calibration: Calibration) -> list[str]:
    """How good a calibration is, in sentences, the most important first."""
    summary, observations = calibration.summary(), calibration.observations
    role = "validation" if summary["rmse"]["validation"] else "calibration"
    error, nominal = summary["rmse"][role], summary["rmse_nominal"][role]
    readings = (
        "readings kept out of the fit"
        if role == "validation"
        else "readings of the fit itself (none were kept out)"
    )
    quality = summary["quality"]
    first, *others = quality["reasons"]
    sentences = [
        f"{quality['verdict'].capitalize()}: {first}",
        *others,
        quality["next"],
        *summary.get("notes", ()),
        f"The calibrated model is off by {_microtesla(error['vector_T'])} rms ({percent(error['relative'], 2)} of the field) on "
        f"{readings}; before calibration it was off by {_microtesla(nominal['vector_T'])} ({percent(nominal['relative'], 2)}).",
        _noise_share(calibration, role),
        f"Its 90 % intervals hold {percent(summary['coverage90'][role], 1)} of the components of these readings.",
    ]
    for entry in _most_probable(summary["loop_counts"]):
        sentences.append(
            f"{entry['coil']} has {entry['axial']} x {entry['radial']} loops with probability "
            f"{probability(entry['probability'])}{condition(quality)}."
        )
    for coil, told in summary.get("amplitudes", {}).items():
        sentences.append(
            f"The readings determine {told['determined']} of {told['free']} amplitudes of {coil}, which has no winding; along the others, "
            "and away from the readings, the width of the prior is left."
        )
    n_fit = len(observations.calibration)
    sentences.append(f"{n_fit} readings determined {len(summary['point_estimate']['values'])} parameters.")
    return sentences


def _noise_share(calibration: Calibration, role: str) -> str:
    """The rms of the vector from noise alone, as large as it was found."""
    sensors = calibration.rig.sensors
    noise_T = noise_rms_T(calibration.observations, calibration.rig, calibration.best, role)
    is_fitted = any(f"{sensor.name}.noise_T" in calibration.draws for sensor in sensors)
    return (
        f"Noise as large as {'the fit found' if is_fitted else 'the rig file says'} would by itself leave "
        f"{_microtesla(noise_T)}."
    )


def undetermined_sentence(words: str, data_over_prior_sd: float) -> str:
    """What readings say of a combination of parameters that the prior knows better.

    Examples:
        >>> undetermined_sentence("the wire radius", 28.0)
        "These readings say almost nothing about the wire radius: its interval is the prior's."
    """
    if data_over_prior_sd > HARDLY_NARROWED:
        return f"These readings say almost nothing about {words}: its interval is the prior's."
    return f"These readings say less about {words} than the prior does: its interval is mostly the prior's."


def warning_sentences(summary: Mapping[str, Any]) -> list[str]:
    """What a reader of a calibration must not overlook."""
    warnings = []
    if not summary["is_converged"]:
        warnings.append(f"Sampling did not converge: {_sampling(summary)}. The intervals are provisional.")
    has_real_counts = not summary["has_integer_counts"] and any(
        name.endswith("_loops") for name in summary["parameters"]
    )
    if wider := summary.get("widening"):
        largest = max(factor for name, factor in wider.items() if not name.endswith("_loops"))
        warnings.append(
            "The diagnosis leaves something in the readings unexplained: standard deviations are up to "
            f"{largest:.3g} times those of the fit alone."
        )
        if has_real_counts:
            warnings.append(
                "Too many loop counts are plausible with that for a table of them: they are real numbers here."
            )
    elif has_real_counts:
        warnings.append("Loop counts are hardly determined by the data and were sampled as real numbers.")
    for direction in told_by_data(summary["undetermined"], summary.get("fitted_besides", ())):
        warnings.append(undetermined_sentence(direction["words"], direction["data_over_prior_sd"]))
    for name, distance in summary["prior_tension"].items():
        warnings.append(
            f"{split_quotient(name)[0]} lies {abs(distance):.1f} standard deviations of its prior {'above' if distance > 0 else 'below'} "
            "the prior's centre: the prior is too narrow, or the model lacks something and this parameter stands in for it."
        )
    estimate = summary["point_estimate"]
    if estimate["starts_agreeing"] < 0.5 * estimate["starts"]:
        warnings.append(
            f"Only {estimate['starts_agreeing']} of {estimate['starts']} starts found the best maximum: there may be several."
        )
    return warnings


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
            show.with_sd(numbers["median"], numbers["sd"]),
            show.interval(numbers["ci90"], numbers["sd"]),
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


def _amplitude_table(
    rig: Rig, parameters: Mapping[str, Any], determined: Mapping[str, Mapping[str, int]]
) -> Table:
    """Amplitudes of coils without a winding by degree; each one is in summary.json. Coils without current have only their priors."""
    rows = []
    for coil in rig.unwound:
        if not determined.get(coil.name, {}).get("determined"):
            continue
        has_degrees = isinstance(coil, HarmonicCoil)
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
                    str(degree) if has_degrees else _sources_words(coil),
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
                    _microtesla(metrics["vector_T"]),
                    _microtesla(metrics["component_T"]),
                    _microtesla(metrics["paper_metric_T"]),
                    _microtesla(metrics["max_T"]),
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
        [name, _microtesla(metrics["vector_T"]), percent(metrics["relative"], 3)]
        for name, metrics in summary["rmse_by_sensor"]["calibration"].items()
    ]
    return Table("Errors by sensor", ["sensor", "vector rms", "of rms field"], rows)


def _most_probable(loop_counts: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The first entry of each coil."""
    by_coil: dict[str, Mapping[str, Any]] = {}
    for entry in loop_counts:
        by_coil.setdefault(entry["coil"], entry)
    return list(by_coil.values())


def _sampling(summary: Mapping[str, Any]) -> str:
    sampling = summary["sampling"]
    if "widening" in summary:
        return f"{sampling['steps'] * sampling['walkers']} independent draws of a normal law"
    rhat = f"{sampling['largest_rhat']:.4f}" if sampling["largest_rhat"] is not None else "none"
    return (
        f"{sampling['steps']} steps of {sampling['walkers']} walkers, acceptance {sampling['acceptance']:.2f}, "
        f"smallest effective sample size {sampling['smallest_ess']:.0f}, largest R-hat {rhat}"
    )


def _microtesla(value_T: float) -> str:
    return f"{value_T * 1e6:.4g} µT"
