"""What a terminal and a notebook show of a session."""

from __future__ import annotations

import numpy as np

from estimator.glance import Glance, scatter_svg, with_unit
from estimator.store.session import Session

MOST_POINTS = 500  # in the picture


def glance(session: Session) -> Glance:
    """A session in a sentence, the ranges of its columns, and the size of the field over time."""
    rig, o = session.rig, session.observations
    n_validation = int(o.is_validation.sum())
    hours = (float(o.time_s.max()) - float(o.time_s.min())) / 3600.0 if len(o) else 0.0
    sentence = (
        f"Session of rig {rig.name!r}: {len(o)} readings ({n_validation} of them for validation) over {hours:.3g} h, "
        f"recorded {session.created[:16]}, from {session.source}."
    )
    columns = {f"{coil.name} current": (o.current_A[:, i].numpy(), "A") for i, coil in enumerate(rig.coils)}
    fields = {f"B{axis}": (o.field_sensor_T[:, i].numpy(), "T") for i, axis in enumerate("xyz")}
    places = {}
    for mover in rig.movers:
        for i, name in enumerate(mover.columns):
            quantity, _, unit = name.rpartition("_")
            values = o.motion[mover.name][:, i].numpy()
            if len(values) and np.ptp(values) > 0.0:
                places[quantity] = (values, unit)
    rows = []
    for name, (values, unit) in {**columns, **fields, **places}.items():
        known = values[np.isfinite(values)]
        if len(known):
            rows.append((name, with_unit(float(known.min()), unit), with_unit(float(known.max()), unit)))
    return Glance(sentence, ("column", "lowest", "highest"), rows, lambda: _over_time(session))


def _over_time(session: Session) -> str:
    o = session.observations
    size_mT = 1e3 * np.linalg.norm(np.nan_to_num(o.field_sensor_T.numpy()), axis=1)
    rows = np.unique(np.linspace(0, len(o) - 1, min(len(o), MOST_POINTS)).astype(int))
    minutes = (o.time_s.numpy() - float(o.time_s.min())) / 60.0
    marked = o.is_validation.numpy()[rows].tolist()
    return scatter_svg(
        minutes[rows].tolist(), size_mT[rows].tolist(), marked, "minutes", "|B| in mT, hollow: validation"
    )
