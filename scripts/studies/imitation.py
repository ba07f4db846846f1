"""What readings could tell of a wrong name: how far the best that the named causes can do stays from a session without noise.

A name is not the hidden one, yet often the same to every reading: a plate for a sphere of iron far away, a gain by polarity for an
asymmetric supply. No rule tells those apart. So the rig with the named causes is fitted to the perfect readings of the session, noise and
priors as they were. What it leaves, in standard deviations, is the root of twice the log likelihood ratio that speaks against the name.
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import replace
from pathlib import Path

from estimator import Diagnosis, load_rig
from estimator.diagnosis.fitting import fit_rig
from estimator.diagnosis.mixture.full_fits import leading_fit
from estimator.rig.parameters import LogNormal, Normal
from estimator.rig.rig import Rig
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.flaw import record
from tests.hidden.handed_in import HiddenSession


def left_of_truth(hidden: HiddenSession, diagnosis: Diagnosis) -> float:
    """Misfit of the listed causes that lead, in standard deviations, beyond that of the true numbers without any misfit.

    Numbers that leave their priors count as misfit, as in the density that was fitted.
    """
    fit = leading_fit(diagnosis.findings.answer)
    perfect = replace(hidden, record=record(hidden.scene, hidden.flaws, None))
    with tempfile.TemporaryDirectory() as folder:
        perfect.write(Path(folder))
        readings = read_readings_csv(Path(folder) / "readings.csv", load_rig(Path(folder) / "rig.yaml"))
    truth = hidden.truth()["values"]
    noise_T = {name: truth[name] for name in truth if name.endswith(".noise_T")}
    rig = fit.rig.with_values(noise_T).with_fixed(noise_T)
    fitted = fit_rig(
        rig, readings.observations.calibration, {**fit.values, **noise_T}, fit.posterior.model.rules
    )
    values = {name: float(value) for name, value in fitted.values.items()}
    misfit = float(fitted.posterior.whitened(fitted.vector).square().sum()) + _tension(rig, values)
    return math.sqrt(max(misfit - _tension(rig, truth), 0.0))


def _tension(rig: Rig, values: dict[str, float]) -> float:
    """Sum of the squared distances of some numbers from their priors, in the priors' standard deviations."""
    priors = {p.name: p.prior for p in rig.free if p.name in values}
    bells = {name: prior for name, prior in priors.items() if isinstance(prior, Normal | LogNormal)}
    return sum(prior.distance(values[name]) ** 2 for name, prior in bells.items())
