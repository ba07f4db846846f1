"""What a terminal and a notebook show of a diagnosis, and its figures one by one."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimator.diagnosis.figures import budget_pictures
from estimator.diagnosis.headline import headline
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.statements.residuals import sigma_T
from estimator.diagnosis.structure.covariates import residual_T
from estimator.errors import InvalidInput
from estimator.glance import Glance
from estimator.reporting import plots
from estimator.reporting.numbers import probability
from estimator.reporting.page import picture_html


def glance(diagnosis: Diagnosis) -> Glance:
    """A diagnosis in its first sentence, its causes with their sizes, and the error budget or the residuals."""
    first = next(iter(headline(diagnosis)), "")
    rows = [
        (sized.name, probability(sized.probability), name, interval.words)
        for sized in diagnosis.sized_causes
        for name, interval in sized.sizes
    ]
    words = f"Diagnosis of {diagnosis.rig.name!r}, {diagnosis.verdict}: {first}"
    header = ("cause", "probability", "quantity", "size, 90 % interval")
    return Glance(words, header, rows, lambda: _picture(diagnosis))


def _picture(diagnosis: Diagnosis) -> str:
    if diagnosis.fits.budget is not None:
        return picture_html("Error budget", plot_budget(diagnosis))
    return picture_html("Residuals", lambda: plot_residuals(diagnosis, None, True))


def plot_residuals(diagnosis: Diagnosis, ax: Axes | None, extended: bool) -> Axes:
    """See `Diagnosis.plot_residuals`."""
    fit = diagnosis.fits.extended if extended else diagnosis.fits.plain
    return plots.residual_histogram(residual_T(fit).numpy(), sigma_T(fit).numpy(), ax, diagnosis.rig.name)


def plot_budget(diagnosis: Diagnosis) -> Figure:
    """See `Diagnosis.plot_budget`."""
    for picture in budget_pictures(diagnosis):
        return picture.figure
    raise InvalidInput(
        "a budget needs causes and readings that were kept out of the fits; this diagnosis lacks one of them"
    )
