"""Multipoles beside a box of charges, where readings ask for them.

Charges on a box stand for sources no nearer to it than they are themselves. A small source that is nearer shows at a few places only, and
the noise takes up what the charges miss there. Its place is found (`place_search`) and then held as known, so intervals right beside it are
too narrow.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimator.calibration.place_search import Found, PlaceSearch
from estimator.errors import InvalidInput
from estimator.inference.collapsed import CollapsedPosterior
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.bodies import AnyCoil, EquivalentSourceCoil
from estimator.rig.charged_box import Triple
from estimator.rig.coordinates import Coordinates
from estimator.rig.parameters import Normal, Parameter
from estimator.rig.rig import Rig

SPARSE_M = 1e3  # leaves charges at corners only, where none is needed


def with_multipoles(rig: Rig, observations: Observations) -> tuple[Rig, Found]:
    """The rig with multipoles beside its box of charges where readings ask for them, and what was found.

    Args:
        rig: With a single coil without a winding, whose charges all have one prior; beside these only the noise of one sensor is free.
        observations: Those for validation are not looked at.
    Raises: InvalidInput: The rig is another.
    """
    seen = observations.calibration
    posterior = CollapsedPosterior(LogPosterior(Coordinates(rig), MeasurementModel.build(rig, seen), seen))
    coil, prior = _searchable(rig, posterior.coordinates.names)
    charges_T, measured_T = posterior.at_start
    model = posterior.full.model
    is_on = seen.current_A[:, rig.coils.index(coil)] != 0.0
    seen_m = model.readings_in_coil(coil, model.nominal)[0][is_on]

    sparse = replace(coil, spacing_m=SPARSE_M)
    silent = {name: Parameter(name, "T/A", 0.0) for name in sparse.amplitudes[1]}
    others = {name: p for name, p in rig.parameters.items() if name not in coil.amplitudes[1]}
    bare = replace(rig, coils=_replaced(rig, sparse), parameters={**others, **silent})

    def columns(place_m: Triple) -> np.ndarray:
        multipole_rig = _with_coil(bare, replace(sparse, multipoles_m=(place_m,)), prior)
        with_one = LogPosterior.by_rules(Coordinates(multipole_rig), seen, model.rules)
        own = CollapsedPosterior(with_one)
        return own.at_start[0].numpy()

    multipoles = PlaceSearch(coil, seen_m.numpy(), charges_T.numpy(), columns).find(measured_T.numpy())
    placed = replace(coil, multipoles_m=(*coil.multipoles_m, *multipoles.places_m))
    return _with_coil(rig, placed, prior), multipoles


def _searchable(rig: Rig, others: tuple[str, ...]) -> tuple[EquivalentSourceCoil, Normal]:
    """The coil of a rig that can be searched, and the prior of its amplitudes."""
    what = "a rig whose multipoles are searched"
    boxes = [coil for coil in rig.unwound if isinstance(coil, EquivalentSourceCoil) and not coil.multipoles_m]
    if len(boxes) != 1 or len(rig.unwound) != 1:
        names = ", ".join(coil.name for coil in rig.unwound) or "none"
        raise InvalidInput(
            f"{what} must have one coil without a winding, with charges on a box and no multipoles yet; received {names} ({rig.name})"
        )
    (coil,) = boxes
    priors = {rig.parameters[name].prior for name in coil.amplitudes[1]}
    (prior, *more) = priors
    if more or not isinstance(prior, Normal) or prior.mean != 0.0:
        raise InvalidInput(
            f"{what} must give all charges of {coil.name} one normal prior about 0; received others ({rig.name})"
        )
    if len(rig.sensors) != 1 or not set(others) <= {f"{rig.sensors[0].name}.noise_T"}:
        raise InvalidInput(
            f"{what} must leave nothing free but amplitudes and the noise of one sensor; received {', '.join(others)} ({rig.name})"
        )
    return coil, prior


def _replaced(rig: Rig, own: EquivalentSourceCoil) -> tuple[AnyCoil, ...]:
    return tuple(own if coil.name == own.name else coil for coil in rig.coils)


def _with_coil(rig: Rig, coil: EquivalentSourceCoil, prior: Normal) -> Rig:
    """The rig with another coil of the same name, whose new amplitudes have the prior of the charges."""
    new = {
        name: Parameter(name, "T/A", 0.0, prior) for name in coil.amplitudes[1] if name not in rig.parameters
    }
    return replace(rig, coils=_replaced(rig, coil), parameters={**rig.parameters, **new})
