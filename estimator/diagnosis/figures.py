"""The figures of one diagnosis: residuals before and after, what the extension explains, structure, and all hypotheses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from jaxtyping import Float
from matplotlib.axes import Axes
from torch import Tensor

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.part_by_part import part_by_part
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.statements.hypotheses import role_of
from estimator.diagnosis.statements.residuals import around_coils, is_extended, sigma_T
from estimator.diagnosis.structure.covariates import Covariate, predicted_T, residual_T
from estimator.diagnosis.structure.residual_tests import N_NOISE_DRAWS
from estimator.effects.corrections.correction import KEY
from estimator.model.bodies import round_winding_of
from estimator.reporting import plots
from estimator.reporting.numbers import SHOWN_IN, size_with_unit
from estimator.reporting.page import Picture
from estimator.units import UNITS

MOST_STEPS, MOST_COVARIATES = 4, 12
MOST_IN_TITLE = 3


def pictures(diagnosis: Diagnosis) -> list[Picture]:
    """The figures of the report, each with a title and a caption that says what to look for."""
    parts = (_maps, budget_pictures, _explained, _corrected, _structure, _ranking)
    return part_by_part(parts, diagnosis)


def _maps(diagnosis: Diagnosis) -> Iterator[Picture]:
    extended, title = diagnosis.fits.extended, diagnosis.rig.name
    before_T, after_T = (residual_T(fit).numpy() for fit in (diagnosis.fits.plain, extended))
    noise_T = sigma_T(extended).numpy()
    one_sigma = float(noise_T.max()) if np.ptp(noise_T) < 1e-12 else None
    for around in around_coils(diagnosis):
        coil, is_on, position_m = around.coil, around.is_on.numpy(), around.position_m.numpy()
        winding = round_winding_of(extended.rig, coil, extended.values)
        words = "Magnitude of the residual vector at the sensor's positions, in the coil's frame"
        if is_extended(diagnosis):
            yield Picture(
                f"Residual around {coil.name}, before and after",
                f"{words}; both maps share one colour scale. After the extension it should look like noise.",
                plots.before_and_after_map(
                    position_m, before_T[is_on], after_T[is_on], winding, one_sigma, title
                ),
            )
        else:
            yield Picture(
                f"Residual around {coil.name}",
                f"{words}. A pattern means a model error.",
                plots.residual_map(position_m, before_T[is_on], winding, one_sigma, title),
            )


def budget_pictures(diagnosis: Diagnosis) -> Iterator[Picture]:
    """The error budget, where there is one."""
    budget = diagnosis.fits.budget
    if budget is None:
        return
    shares = {diagnosis.label(cause): (s.value, s.ci90) for cause, s in budget.causes.items()}
    corrected = (
        () if diagnosis.fits.correction is None else [part.cause for part in diagnosis.fits.correction.parts]
    )
    roles = [plots.Role.LEFT if cause in corrected else role_of(diagnosis, cause) for cause in budget.causes]
    if len(budget.causes) > 1:
        shares["shared by several"] = (budget.shared.value, budget.shared.ci90)
        roles.append(plots.Role.OTHER)
    shares["not explained"] = (budget.left.value, budget.left.ci90)
    orders = "" if budget.has_all_orders else ", as wide as two orders differ"
    yield Picture(
        "Error budget",
        f"What the rig as described misses of {budget.n_readings} readings that no fit has seen, beyond the noise: "
        f"{size_with_unit(budget.misfit_T, 'T', 3)} rms. Each bar is the share that a cause accounts for, the mean over orders of adding "
        f"them; lines are 90 % intervals over the choice of the readings{orders}.",
        plots.error_budget(shares, [*roles, plots.Role.LEFT], title=diagnosis.rig.name),
    )


def _explained(diagnosis: Diagnosis) -> Iterator[Picture]:
    before, after = diagnosis.fits.plain, diagnosis.fits.extended
    labels = [diagnosis.label(cause) for cause in after.rig.effects if cause not in before.rig.effects]
    if not labels:
        return
    names = " + ".join(labels) if len(labels) <= MOST_IN_TITLE else f"{len(labels)} causes together"
    change_T = predicted_T(after) - predicted_T(before)
    yield Picture(
        "What the extension explains",
        "Residual of the plain model against the change of the prediction by the extension, for each reading. The means should follow the "
        "slanted line.",
        _explaining(residual_T(before), change_T, after, names),
    )


def _corrected(diagnosis: Diagnosis) -> Iterator[Picture]:
    correction = diagnosis.fits.correction
    if correction is None or not correction.parts:
        return
    fit = correction.fit
    amplitudes = [
        name
        for part in correction.parts
        for key, name in fit.rig.names_of(part.cause).items()
        if KEY.fullmatch(key)
    ]
    zero = torch.tensor(0.0, dtype=torch.float64)
    with torch.no_grad():
        without_T = fit.posterior.model.predict({**fit.values, **dict.fromkeys(amplitudes, zero)})
    change_T = predicted_T(fit) - without_T
    yield Picture(
        "What is corrected without a name",
        "Residual without the corrections against what they add to the prediction, for each reading. The means should follow the slanted "
        "line; points far from it are what is left.",
        _explaining(
            residual_T(fit) + change_T,
            change_T,
            fit,
            " + ".join(diagnosis.label(part.cause) for part in correction.parts),
        ),
    )


def _explaining(missed_T: Tensor, change_T: Tensor, fit: Fit, title: str) -> Axes:
    """What a fit misses without something, against what that changes."""
    return plots.explained_residual(missed_T.numpy(), change_T.numpy(), sigma_T(fit).numpy(), title=title)


def _structure(diagnosis: Diagnosis) -> Iterator[Picture]:
    before = diagnosis.fits.before.structure
    after = {test.covariate.name: test for test in diagnosis.fits.after.structure}
    tests = [test for test in before if test.covariate.name in after][:MOST_COVARIATES]
    names = [test.covariate.name for test in tests]
    yield Picture(
        "Structure of the residual along covariates",
        "The residual depends on a covariate whose bar leaves the grey zone. p-values are adjusted for testing all covariates together: "
        "pure noise leaves the zone in 5 % of sessions.",
        plots.structure_bars(
            names,
            [test.p_value for test in tests],
            [after[name].p_value for name in names],
            title=diagnosis.rig.name,
            floor=1.0 / (N_NOISE_DRAWS + 1),
        ),
    )
    if tests:
        first = tests[0].covariate
        yield from _along(diagnosis, first, after[first.name].covariate)


def _along(diagnosis: Diagnosis, before: Covariate, after: Covariate) -> Iterator[Picture]:
    """Residuals along a covariate as it is before and after the extension, on one scale so that the eye can compare."""
    factor, unit = _display(before.unit, before.by_reading)
    label = f"{before.name} ({unit})" if unit != "1" else before.name
    fits = {"before": (diagnosis.fits.plain, before)}
    if is_extended(diagnosis):
        fits["after"] = (diagnosis.fits.extended, after)
    drawn = {
        when: plots.residual_against(
            covariate.by_reading.numpy() * factor,
            residual_T(fit).numpy(),
            sigma_T(fit).numpy(),
            label,
            title=when,
        )
        for when, (fit, covariate) in fits.items()
    }
    if len({ax.get_ylabel() for ax in drawn.values()}) == 1:
        ends = np.array([ax.get_ylim() for ax in drawn.values()])
        for ax in drawn.values():
            ax.set_ylim(ends[:, 0].min(), ends[:, 1].max())
    for when, ax in drawn.items():
        yield Picture(
            f"Residual along the most significant covariate, {when}",
            "The lines are means of neighbouring readings. Means that leave the band by several of their error bars show structure.",
            ax,
        )


def _ranking(diagnosis: Diagnosis) -> Iterator[Picture]:
    for number, (title, comparison) in enumerate(diagnosis.comparisons[:MOST_STEPS], start=1):
        evidence, roles = {}, {}
        for hypothesis in comparison.hypotheses:
            label = diagnosis.label_of_hypothesis(hypothesis)
            evidence[label] = hypothesis.log_bayes_factor
            if hypothesis.cause is not None:
                roles[label] = role_of(diagnosis, hypothesis.cause, comparison.taken)
        stated = diagnosis.label(comparison.taken[0]) if comparison.taken else None
        words = f"in the place of {title}, which is stated" if stated else "as one cause more"
        yield Picture(
            f"Hypotheses, comparison {number}",
            f"Each hypothesis {words}, with all other leading causes in the model: its log Bayes factor over “nothing wrong”.",
            plots.evidence_bars(evidence, stated, roles, title=title),
        )


def _display(unit: str, values: Float[Tensor, " reading"]) -> tuple[float, str]:
    """Factor and unit for display; a field of the size of the coil's own is shown in mT, a small one in µT."""
    is_strong = unit == "T" and float(values.abs().max()) > UNITS["mT"].to_si
    shown = "mT" if is_strong else SHOWN_IN.get(unit, unit)
    factor = UNITS[unit].to_si / UNITS[shown].to_si if unit in UNITS and shown in UNITS else 1.0
    return factor, shown.replace("u", "µ")
