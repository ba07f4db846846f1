"""A bank of flexible curves for what no known cause explains: in position, field, time, history and settings.

Each family holds smooth functions of one covariate, with an amplitude of its own and a normal prior that narrows with the order. Its
evidence competes with that of the causes (`structure.discrepancy`, docs/decisions/0008).
"""

from __future__ import annotations

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.structure.families.collection import Collection, Family
from estimator.diagnosis.structure.families.history import add_history
from estimator.diagnosis.structure.families.position import add_positions
from estimator.diagnosis.structure.families.settings import add_settings
from estimator.diagnosis.structure.families.time import add_time


def families(fit: Fit) -> list[Family]:
    """The families of a session. Constant and linear terms are left out where causes stand for them."""
    collection = Collection(fit)
    for coil in fit.rig.coils:
        add_positions(collection, coil)
    add_time(collection)
    add_history(collection)
    add_settings(collection)
    return collection.families
