"""What a calibration says of itself in sentences, for its report and the page of the service."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from estimator.calibration.notes import MOST_TOLD, told_by_data
from estimator.calibration.quality import condition
from estimator.calibration.result import Calibration
from estimator.inference.laplace import TOGETHER
from estimator.inference.noise_of_readings import noise_rms_T
from estimator.reporting.numbers import microtesla, percent, probability
from estimator.units import split_quotient

HARDLY_NARROWED = 3.0  # data as wide as three priors narrow the interval by 5 %, which no reader sees


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
        f"The calibrated model is off by {microtesla(error['vector_T'])} rms ({percent(error['relative'], 2)} of the field) on "
        f"{readings}; before calibration it was off by {microtesla(nominal['vector_T'])} ({percent(nominal['relative'], 2)}).",
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
    n_free = len(summary["point_estimate"]["values"])
    sentences.append(f"{n_free} free parameters were fitted to {n_fit} readings.")
    return sentences


def _noise_share(calibration: Calibration, role: str) -> str:
    """The rms of the vector from noise alone, as large as it was found."""
    sensors = calibration.rig.sensors
    observations = calibration.observations
    judged = observations.validation if role == "validation" else observations.calibration
    noise_T = noise_rms_T(calibration.rig, judged, calibration.best)
    is_fitted = any(f"{sensor.name}.noise_T" in calibration.draws for sensor in sensors)
    return (
        f"Noise as large as {'the fit found' if is_fitted else 'the rig file says'} would by itself leave "
        f"{microtesla(noise_T)}."
    )


def undetermined_sentence(words: str, data_over_prior_sd: float) -> str:
    """What readings say of a parameter, or of a combination of some, that the prior knows better.

    Examples:
        >>> undetermined_sentence("the wire radius", 28.0)
        "These readings say almost nothing about the wire radius: its interval is the prior's."
        >>> undetermined_sentence("the length up together with the thickness up", 28.0)
        'These readings hardly show a change of the length up together with the thickness up: such a change is known mostly from the prior.'
    """
    if TOGETHER in words:
        return (
            f"These readings hardly show a change of {words}: such a change is known mostly from the prior."
        )
    if data_over_prior_sd > HARDLY_NARROWED:
        return f"These readings say almost nothing about {words}: its interval is the prior's."
    return f"These readings say less about {words} than the prior does: its interval is mostly the prior's."


def warning_sentences(summary: Mapping[str, Any]) -> list[str]:
    """What a reader of a calibration must not overlook."""
    warnings = []
    if not summary["is_converged"]:
        warnings.append(
            f"Sampling did not converge: {sampling_words(summary)}. The intervals are provisional."
        )
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
    undetermined = told_by_data(summary["undetermined"], summary.get("fitted_besides", ()))
    for direction in undetermined[:MOST_TOLD]:
        warnings.append(undetermined_sentence(direction["words"], direction["data_over_prior_sd"]))
    if len(undetermined) > MOST_TOLD:
        warnings.append(
            f"Nor do they determine {len(undetermined) - MOST_TOLD} more combinations, which summary.json lists."
        )
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


def _most_probable(loop_counts: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The first entry of each coil."""
    by_coil: dict[str, Mapping[str, Any]] = {}
    for entry in loop_counts:
        by_coil.setdefault(entry["coil"], entry)
    return list(by_coil.values())


def sampling_words(summary: Mapping[str, Any]) -> str:
    """How the posterior was sampled."""
    sampling = summary["sampling"]
    if "widening" in summary:
        return f"{sampling['steps'] * sampling['walkers']} independent draws of a normal law"
    rhat = f"{sampling['largest_rhat']:.4f}" if sampling["largest_rhat"] is not None else "none"
    return (
        f"{sampling['steps']} steps of {sampling['walkers']} walkers, acceptance {sampling['acceptance']:.2f}, "
        f"smallest effective sample size {sampling['smallest_ess']:.0f}, largest R-hat {rhat}"
    )
