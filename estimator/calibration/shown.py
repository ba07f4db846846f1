"""What a terminal and a notebook show of a calibration, and its figures one by one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from estimator.errors import InvalidInput, quoted
from estimator.glance import Glance
from estimator.reporting.numbers import displays, microtesla

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from estimator.calibration.result import Calibration


def glance(calibration: Calibration) -> Glance:
    """A calibration in a sentence, its parameters, and what the data taught."""
    summary = calibration.summary()
    quality = summary.get("quality", {})
    error = summary["rmse"]["validation"] or summary["rmse"]["calibration"]
    unseen = "unseen readings" if summary["rmse"]["validation"] else "the readings of the fit"
    verdict = f" {quality['verdict'].capitalize()}: {quality['reasons'][0]}" if quality else ""
    sentence = (
        f"Calibration of {calibration.rig.name!r} from {len(calibration.observations.calibration)} readings; off by "
        f"{microtesla(error['vector_T'])} rms on {unseen}.{verdict}"
    )
    rows = []
    for name, display in displays(list(summary["parameters"])).items():
        numbers = summary["parameters"][name]
        sizes = (
            display.with_sd(numbers["median"], numbers["sd"]),
            display.interval(numbers["ci90"], numbers["sd"]),
        )
        rows.append((display.words, *sizes, display.unit))
    return Glance(
        sentence, ("parameter", "median ± sd", "90 % interval", "unit"), rows, lambda: _taught(calibration)
    )


def _taught(calibration: Calibration) -> str:
    from estimator.reporting.page import picture_html

    return (
        picture_html("What the data taught", lambda: plot_parameters(calibration))
        if calibration.draws
        else ""
    )


def plot_field(calibration: Calibration, coil: str | None) -> Figure:
    """See `Calibration.plot_field`."""
    from estimator.calibration.figures import field_picture

    names = [each.name for each in calibration.rig.coils]
    name = names[0] if coil is None else coil
    if name not in names:
        raise InvalidInput(f"coil must be one of {', '.join(names)}; received {quoted(name)}")
    picture = field_picture(calibration, name)
    if picture is None:
        raise InvalidInput(f"coil must have carried current in some reading; {name} never did")
    return picture.figure


def plot_residuals(calibration: Calibration, ax: Axes | None) -> Axes:
    """See `Calibration.plot_residuals`."""
    from estimator.calibration.fitted import fitted
    from estimator.reporting import plots

    fit = fitted(calibration)
    return plots.residual_histogram(fit.residual_T, fit.sigma_T, ax, calibration.rig.name)


def plot_parameters(calibration: Calibration, ax: Axes | None = None) -> Axes:
    """See `Calibration.plot_parameters`."""
    from estimator.calibration.figures import MOST_INTERVALS
    from estimator.reporting import plots

    priors = {p.name: p.prior for p in calibration.rig.free if p.prior is not None}
    draws = {name: calibration.draws[name].reshape(-1) for name in list(priors)[:MOST_INTERVALS]}
    truth = calibration.summary()["truth"] or None
    return plots.interval_summary(draws, priors, truth, ax, calibration.rig.name)
