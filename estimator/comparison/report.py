"""The HTML page of one comparison: which description explains the readings, where the others do not, and how exact the map is."""

from __future__ import annotations

from matplotlib.figure import Figure

from estimator.comparison.compare import Comparison, Explained, Rival
from estimator.diagnosis.structure.covariates import sensor_in_coils
from estimator.reporting import plots
from estimator.reporting.page import Picture, ReportPage, Table, render_report

WORDS = {
    Explained.BOTH: "Both the map and the coil model explain the readings.",
    Explained.COIL_MODEL: "The coil model explains the readings, the map does not.",
    Explained.MAP: "The map explains the readings, the coil model does not.",
    Explained.NEITHER: "Neither the map nor the coil model explains the readings.",
}


def comparison_report(comparison: Comparison, source: str, command: str) -> str:
    """HTML of one comparison, self-contained.

    Args:
        comparison: The result of `compare`.
        source: Of the readings.
        command: Command that produced it, shown as provenance.
    """
    rig = comparison.coil_model.fit.rig
    rivals = {"coil model": comparison.coil_model, "map": comparison.map}
    page = ReportPage(
        title=f"A field map of {comparison.coil} on {rig.name}",
        subtitle=source,
        verdict=sentences(comparison),
        warnings=_warnings(comparison),
        tables=[_sizes(rivals), _shells(comparison)],
        figures=[_picture(name, rival, comparison.coil) for name, rival in rivals.items()],
        provenance={"command": command, "rig": rig.hash},
    )
    return render_report(page)


def sentences(comparison: Comparison) -> list[str]:
    """The result in words, the verdict first."""
    lines = [WORDS[comparison.explained]]
    better = comparison.improvement
    if better is not None:
        verb = "better" if better.elpd_difference > 0.0 else "worse"
        lines.append(
            f"The map predicts readings that neither has seen {verb}, by {abs(better.elpd_difference):.1f} ± {better.elpd_se:.1f} in log "
            "predictive density."
        )
    for name, rival in (("coil model", comparison.coil_model), ("map", comparison.map)):
        along = [test.covariate.name for test in rival.structure if not rival.explains][:2]
        if along:
            lines.append(f"The residual of the {name} goes most with: {'; '.join(along)}.")
    return lines


def _warnings(comparison: Comparison) -> list[str]:
    warnings = []
    if comparison.is_coarse:
        warnings.append(
            f"The map is interpolated to {1e6 * comparison.interpolation_error_T:.3g} uT, which is not small beside the noise of "
            f"{1e6 * comparison.map.lack_of_fit.noise_T:.3g} uT: a finer grid may judge it otherwise."
        )
    if comparison.outside:
        warnings.append(f"{comparison.outside} readings lie outside the map and were left out.")
    if comparison.improvement is None:
        warnings.append("No readings were kept out of the fits.")
    return warnings


def _sizes(rivals: dict[str, Rival]) -> Table:
    rows = [
        [
            name,
            f"{1e6 * rival.lack_of_fit.rms_T:.4g} uT",
            f"{1e6 * rival.lack_of_fit.noise_T:.4g} uT ({rival.lack_of_fit.noise_from})",
            f"{rival.lack_of_fit.p_value:.2g}",
            f"{rival.structure[0].p_value:.2g}",
            "yes" if rival.explains else "no",
        ]
        for name, rival in rivals.items()
    ]
    header = ["description", "rms residual", "noise", "p of the size", "p of structure", "explains"]
    return Table(
        "Residuals of both descriptions",
        header,
        rows,
        "A description explains the readings if both p-values are at least 0.01.",
    )


def _shells(comparison: Comparison) -> Table:
    rows = [
        [
            f"{1e3 * shell.nearest_m:.1f} to {1e3 * shell.farthest_m:.1f} mm",
            str(shell.readings),
            f"{1e6 * shell.coil_model_T:.4g} uT",
            f"{1e6 * shell.map_T:.4g} uT",
        ]
        for shell in comparison.shells
    ]
    header = [f"distance from {comparison.coil}", "readings", "coil model", "map"]
    return Table(
        "Where the residuals are",
        header,
        rows,
        "Rms residual of a component, by distance from the origin of the coil's frame.",
    )


def _picture(name: str, rival: Rival, coil: str) -> Picture:
    distance_mm = 1e3 * sensor_in_coils(rival.fit)[coil].norm(dim=-1).numpy()
    label = f"distance from {coil} (mm)"
    axes = plots.residual_against(
        distance_mm, rival.residual_T.numpy(), rival.lack_of_fit.noise_T, label, title=name
    )
    assert isinstance(axes.figure, Figure)
    words = "Measured less predicted; the band is one sigma of the noise. Means off zero say where the description fails."
    return Picture(f"Residual of the {name}", words, axes.figure)
