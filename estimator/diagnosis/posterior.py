"""The posterior of an extended rig, widened by what remains unexplained."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from estimator.calibration.calibrate import calibrate
from estimator.calibration.result import Calibration
from estimator.calibration.summary import summary
from estimator.diagnosis.widening import Widening
from estimator.inference.ensemble import SamplerSettings
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from estimator.store.session import Session


def extended_posterior(
    session: Session,
    rig: Rig,
    widening: Widening | None,
    *,
    out: Path | None = None,
    seed: int = 0,
    settings: SamplerSettings | None = None,
) -> Calibration:
    """Calibrate the extended rig; widen the draws where something remains unexplained.

    Args:
        session: Readings; those marked as validation are kept out.
        rig: The extended rig.
        widening: By how much to widen; None where nothing remains unexplained.
        out, seed, settings: As in `calibrate`; what `out` holds is replaced.
    Returns: The calibrated model. Where its draws were widened, `summary()["widening"]` holds the factor by which the standard deviation
        of each parameter grew.
    """
    sampled = calibrate(session, rig, out=out, overwrite=True, seed=seed, settings=settings)
    if widening is None:
        return sampled
    coordinates = Coordinates(rig, integer_counts=sampled.summary()["has_integer_counts"])
    wider = replace(sampled, draws=widening.spread(coordinates, sampled.draws))
    factors = {
        name: float(wider.draws[name].std() / draws.std()) if draws.std() > 0.0 else 1.0
        for name, draws in sampled.draws.items()
    }
    wider = replace(wider, summary_json={**sampled.summary(), **summary(session, wider), "widening": factors})
    if out is not None:
        wider.save(out)
    return wider
