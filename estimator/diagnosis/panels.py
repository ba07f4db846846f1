"""The panels of a diagnosis, for the page of the service, made while its fits are still in memory."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis.drawing import outline_of, rounded
from estimator.diagnosis.headline import headline, warnings_of
from estimator.diagnosis.mixture.comparison import Comparison
from estimator.diagnosis.panel_records import Panels, ResidualMap, Vectors
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.statements.causes import answer
from estimator.diagnosis.statements.hypotheses import races
from estimator.diagnosis.statements.moved import moved, moved_words
from estimator.diagnosis.statements.next_measurement import next_measurements
from estimator.diagnosis.statements.residuals import Around, around_coils, left_sigma
from estimator.diagnosis.structure.covariates import residual_T
from estimator.rig.rig import Cause

MOST_PATTERNS = 6


def panels(diagnosis: Diagnosis) -> Panels:
    """The panels of a diagnosis that has just been made."""
    plain, extended = diagnosis.fits.plain, diagnosis.fits.extended
    with torch.no_grad():
        noise_T = float(extended.posterior.component_sigma_T(extended.vector).median())
    return Panels(
        rig=diagnosis.rig.name,
        source=diagnosis.question.source,
        verdict=str(diagnosis.verdict),
        headline=headline(diagnosis),
        warnings=warnings_of(diagnosis),
        answers=list(map(answer, diagnosis.sized_causes)),
        n_readings=len(extended.observations),
        noise_T=noise_T,
        left_sigma=(left_sigma(plain, extended), left_sigma(extended, extended)),
        maps=list(_maps(diagnosis)),
        races=races(diagnosis),
        moved=moved(diagnosis),
        moved_words=moved_words(diagnosis),
        next=next_measurements(diagnosis),
    )


def panels_text(made: Panels) -> str:
    """Content of `panels.json`."""
    return json.dumps(asdict(made), allow_nan=False) + "\n"


def _maps(diagnosis: Diagnosis) -> Iterator[ResidualMap]:
    """Residuals around each coil that carried current, as vectors in its frame."""
    plain, extended = diagnosis.fits.plain, diagnosis.fits.extended
    is_known = ~extended.observations.field_sensor_T.isnan().all(-1)
    alone = diagnosis.findings.answer.alone
    leaders = [h.cause for h in alone.hypotheses if h.cause is not None][:MOST_PATTERNS]
    for around in around_coils(diagnosis):
        known = is_known[around.is_on]

        def turned(
            field_sensor_T: Float[Tensor, "reading 3"], around: Around = around, known: Tensor = known
        ) -> Vectors:
            field_T = field_sensor_T[around.is_on].nan_to_num()[..., None]
            return rounded((around.coil_from_sensor @ field_T)[known, :, 0])

        yield ResidualMap(
            coil=around.coil.name,
            winding=outline_of(extended, around.coil),
            position_m=rounded(around.position_m[known]),
            before_T=turned(residual_T(plain)),
            after_T=turned(residual_T(extended)),
            patterns_T={diagnosis.label(cause): turned(_pattern_T(alone, cause)) for cause in leaders},
        )


def _pattern_T(comparison: Comparison, cause: Cause) -> Float[Tensor, "reading 3"]:
    """What a cause alone adds to the predictions, less what the rig's numbers can follow; 0 where a component was not measured."""
    fit = comparison.asked.expansion.fit
    change = comparison.change(comparison.best_item(cause)) / fit.whitening_per_T
    pattern_T = change.new_zeros(len(fit.observations), 3)
    pattern_T[fit.observations.is_measured] = change
    return pattern_T
