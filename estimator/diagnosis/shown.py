"""What a terminal and a notebook show of a diagnosis, and its figures one by one."""

from __future__ import annotations

import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimator.diagnosis.figures import budget_pictures
from estimator.diagnosis.headline import headline
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.structure.covariates import predicted_T
from estimator.errors import InvalidInput
from estimator.glance import Glance
from estimator.reporting import plots
from estimator.reporting.numbers import interval_with_unit, probability, quantity_words
from estimator.reporting.page import picture_html


def diagnosis_glance(diagnosis: Diagnosis) -> Glance:
    """A diagnosis in its first sentence, its causes with their sizes, and the error budget or the residuals."""
    sentences = headline(diagnosis)
    rows = []
    for sized in diagnosis.sized_causes:
        shown = f"{probability(sized.probability)}"
        for key, size in sized.quantities.items():
            low, high = size.ci90
            rows.append(
                (
                    sized.name,
                    shown,
                    quantity_words(key),
                    interval_with_unit(size.median, low, high, size.unit),
                )
            )
    words = f"Diagnosis of {diagnosis.rig.name!r}, {diagnosis.verdict}: {sentences[0] if sentences else ''}"
    return Glance(
        words, ("cause", "probability", "quantity", "size, 90 % interval"), rows, lambda: _picture(diagnosis)
    )


def _picture(diagnosis: Diagnosis) -> str:
    if diagnosis.fits.budget is not None:
        return picture_html("Error budget", plot_budget(diagnosis))
    return picture_html("Residuals", lambda: plot_residuals(diagnosis, None, True))


def plot_residuals(diagnosis: Diagnosis, ax: Axes | None, extended: bool) -> Axes:
    """See `Diagnosis.plot_residuals`."""
    fit = diagnosis.fits.extended if extended else diagnosis.fits.plain
    residual_T = fit.observations.field_sensor_T - predicted_T(fit)
    with torch.no_grad():
        by_sensor_T = fit.posterior.sigma_T(fit.vector)
    sigma_T = by_sensor_T[fit.observations.sensor][:, None].expand(-1, 3)
    return plots.residual_histogram(residual_T.numpy(), sigma_T.numpy(), ax, diagnosis.rig.name)


def plot_budget(diagnosis: Diagnosis) -> Figure:
    """See `Diagnosis.plot_budget`."""
    for picture in budget_pictures(diagnosis):
        return picture.figure
    raise InvalidInput(
        "a budget needs causes and readings that were kept out of the fits; this diagnosis lacks one of them"
    )
