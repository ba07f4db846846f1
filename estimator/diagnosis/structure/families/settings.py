"""Curves in the settings of a reading: currents, temperatures, the mover's position, and any two circumstances together."""

from __future__ import annotations

import math
from itertools import combinations

import torch

from estimator.diagnosis import policy
from estimator.diagnosis.structure.covariates import covariates
from estimator.diagnosis.structure.families.collection import Collection, by_sensor, subsets
from estimator.diagnosis.structure.families.unit_field import unit_field_T
from estimator.diagnosis.structure.smooth import legendre, polynomials, unit_interval
from estimator.geometry.motion import base_from_motion
from estimator.model.nominal import gradient_T_per_m

RANGES = "the range of a sensor"
# Factor on the end of a range: fields of opposite currents are as large to rounding, and stay on one side.
BEYOND = 1.0 + 1e-9


def add_settings(collection: Collection) -> None:
    """Add all families of the settings."""
    collection.add(
        "the reading itself",
        polynomials(unit_interval(collection.field), 2, policy.SMOOTH_DEGREE),
        collection.axes,
    )
    _add_ripples(collection)
    _add_ranges(collection)
    _add_currents(collection)
    _add_mover_positions(collection)
    _add_circumstances(collection)


def _add_ripples(collection: Collection) -> None:
    """Errors of a converter that repeat over its range: waves in what each channel reads, of one period in field for all three."""
    largest_T = float(collection.predicted_T.abs().max())
    for sensor, seen in subsets(collection.fit.posterior.model.circumstances):
        for half_cycles in range(2, min(len(seen), policy.MOST_PERIODS) + 1):
            phase = 0.5 * math.pi * half_cycles * collection.field
            waves = torch.stack((torch.cos(phase), torch.sin(phase))) * seen[:, None]
            fields = torch.diag_embed(waves).movedim(0, 1).flatten(1, 2)
            detail = ", ".join(filter(None, (f"about every {4e3 * largest_T / half_cycles:.2g} mT", sensor)))
            collection.add_fields("a ripple in the reading", fields, detail)


def _add_ranges(collection: Collection) -> None:
    """An instrument that chooses its range: beyond some size of its reading a sensor has other gains, one or three, or other zeros.

    The largest component chooses for all three, or each for itself.
    """
    sizes = collection.field.abs()
    shares = torch.arange(1, policy.N_RANGES + 1).to(sizes) / (policy.N_RANGES + 1)
    for sensor, seen in by_sensor(collection.fit.posterior.model.circumstances):
        its = sizes[seen > 0.0]
        ends = torch.quantile(its.amax(1), shares)
        beyond = ((sizes.amax(1) > BEYOND * ends[:, None]) * seen)[:, :, None]
        details = [sensor] * len(shares)
        for vectors in (collection.field[:, :, None], collection.along_field, collection.axes):
            collection.add_alike(RANGES, beyond, vectors, details)
        for its_end in torch.quantile(its, shares, dim=0):
            larger = torch.diag_embed(collection.field * (sizes > BEYOND * its_end))
            collection.add(RANGES, seen[:, None], larger, sensor)


def _add_currents(collection: Collection) -> None:
    """A field that is not proportional to the current, and what a sensor picks up of the current itself."""
    circumstances = collection.fit.posterior.model.circumstances
    for i, coil in enumerate(collection.fit.rig.coils):
        share = circumstances.current_A[:, i] / circumstances.largest_current_A
        if not bool((share != share[0]).any()):
            continue
        bends = torch.stack((share.abs(), share**2, share.abs() * share, share**3), dim=1)
        name = f"the current of {coil.name}"
        collection.add(name, bends, unit_field_T(collection.fit, i)[:, :, None])
        collection.add(name, legendre(share, policy.SETTING_DEGREE)[:, 1:], collection.axes)


def _add_mover_positions(collection: Collection) -> None:
    """Errors of position that depend on where the mover stands, smoothly or with a period, or on time."""
    fit = collection.fit
    model = fit.posterior.model
    time = 2.0 * model.circumstances.hours / model.circumstances.duration_h - 1.0
    for mover in fit.rig.movers:
        pose = base_from_motion(mover, fit.observations.motion[mover.name])
        position = unit_interval(pose.translation_m)
        slope = gradient_T_per_m(model, fit.values, mover.name)
        name = f"where {mover.name} stands"
        collection.add(name, polynomials(position, 1, policy.MOVER_DEGREE), slope)
        collection.add(name, legendre(time, policy.TIME_DEGREE)[:, 1:], slope, "moving with time")
        for i, axis in enumerate("xyz"):
            half_cycles = torch.arange(2, policy.MOST_PERIODS_ALONG_AXIS + 1, device=position.device)
            phase = 0.5 * math.pi * half_cycles[:, None] * position[:, i]
            waves = torch.stack((torch.cos(phase), torch.sin(phase)), dim=-1)
            collection.add_alike(name, waves, slope, [f"periodic along {axis}"] * len(half_cycles))


def _add_circumstances(collection: Collection) -> None:
    """Smooth curves in each covariate, and products of any two, for every component and every gain."""
    known = covariates(collection.fit)
    scaled = {c.name: unit_interval(c.by_reading[:, None])[:, 0] for c in known}
    for name, values in scaled.items():
        for vectors in (collection.axes, collection.along_field):
            collection.add("one circumstance", legendre(values, policy.SETTING_DEGREE)[:, 1:], vectors, name)
    for (name, values), (other, others) in combinations(scaled.items(), 2):
        collection.add(
            "two circumstances", (values * others)[:, None], collection.axes, f"{name} and {other}"
        )
