"""A calibrated magnet as JSON with units: every number that a program needs to predict its field, and the JSON Schema of the file."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from estimator.code_version import code_version
from estimator.export.calibrated import Calibrated
from estimator.export.linearised import WINDING_NUMBERS, Linearised
from estimator.export.magnet import Magnet
from estimator.export.plain_model import PlainCoil, PlainMover, numbers_of
from estimator.export.request import Request
from estimator.field.coil import AnyWinding
from estimator.field.sided import SidedWinding
from estimator.field.winding import Winding
from estimator.field.zones import ZONES_PER_OCTAVE
from estimator.frames import Transform
from estimator.tensors import Tensor
from estimator.units import MU0_T_M_PER_A

SCHEMA_VERSION = 1
SIDED_NUMBERS = tuple(item.name for item in fields(SidedWinding) if item.name != "is_rounded")
CONVENTIONS = {
    "units": "SI; keys end in their unit, and a key without one holds pure numbers",
    "frames": "a_from_b takes coordinates of b to a: rotate (rows of the matrix), then add translation_m",
    "pose": "world_from_coil = world_from_base * pose of the mover * flange_from_coil; without a mover its pose is no motion",
    "motion": "six columns: position and rotation vector, or joint angles of the Denavit-Hartenberg table; zeros at rest",
    "currents": "delivered = delivered_A_per_A * commanded + offset_A; field = background_T + sum over coils of delivered * field"
    " per ampere",
    "loops": "a loop of radius radius_m - radial_pitch_m * (radial_loops / 2 - radial node) at z = axial_pitch_m *"
    " (axial node - axial_loops / 2) of the coil frame counts axial weight * radial weight times",
    "sides": "a coil with corners winds around a bore of side_x_m times side_y_m instead; a loop lies radial_pitch_m * (radial_loops / 2 +"
    " radial node) outside it all around, and round corners have corner_radius_m more than that",
    "leads": "straight wires from point to point of the coil frame, in the order of the current, which add the field of one ampere in them",
    "rules": f"at a distance d from the cross-section of the winding, level floor({ZONES_PER_OCTAVE} * log2(d)) - first_level, held"
    " between 0 and the last, tells the number of the rule",
    "directions": "how all numbers move along independent standard normal directions of the posterior, to first order; base and flange are"
    " a shift in m and a small rotation in rad of world_from_base and flange_from_coil, in axes of world and flange",
}


def json_model(request: Request) -> str:
    """The text of the file.

    Raises:
        InvalidInput: The rig has something that the file cannot express.
    """
    magnet = request.magnet
    model = magnet.model("json")
    regions_m = [magnet.region_m(coil.name) for coil in model.coils]
    document = {
        "format": "coilcal calibration",
        "schema_version": SCHEMA_VERSION,
        "name": model.name,
        "conventions": CONVENTIONS,
        "origin": _merged(magnet, _origin),
        "parameters": _merged(magnet, _parameters),
        "mu0_T_m_per_A": MU0_T_M_PER_A,
        "coils": [
            _coil(coil, region_m, model.movers) for coil, region_m in zip(model.coils, regions_m, strict=True)
        ],
        "movers": [_mover(mover) for mover in model.movers],
        "delivered_A_per_A": model.delivered_A_per_A.tolist(),
        "offset_A": model.offset_A.tolist(),
        "background_T": model.background_T.tolist(),
        "directions": _directions(magnet.changes),
    }
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def calibration_schema() -> dict[str, Any]:
    """JSON Schema of the file, draft 2020-12.

    Examples:
        >>> calibration_schema()["properties"]["background_T"]
        {'type': 'array', 'items': {'type': 'number'}, 'minItems': 3, 'maxItems': 3}
    """
    text, number, whole = {"type": "string"}, {"type": "number"}, {"type": "integer"}
    three = _list(number, 3)
    pose = _object(translation_m=three, rotation=_list(three, 3))
    rule = _object(
        steps=whole,
        **{f"{way}_{what}": _list(number) for way in ("axial", "radial") for what in ("nodes", "weights")},
    )
    table = _object(**{key: _list(number, 6) for key in ("theta_rad", "a_m", "d_m", "alpha_rad")})
    positive, from_zero = ({"type": "number", key: 0} for key in ("exclusiveMinimum", "minimum"))
    shapes = (
        dict.fromkeys(WINDING_NUMBERS, positive),
        {
            "corners": {"enum": ["sharp", "round"]},
            **dict.fromkeys(SIDED_NUMBERS, positive),
            "corner_radius_m": from_zero,
        },
    )
    coils = [
        _object(
            name=text,
            mover={"type": ["string", "null"]},
            **shape,
            world_from_base=pose,
            flange_from_coil=pose,
            first_level=whole,
            rule_of_level=_list(whole),
            rules=_list(rule),
            leads_m=_list(_list(three, 2)),
            measured_low_m=_or_null(three),
            measured_high_m=_or_null(three),
        )
        for shape in shapes
    ]
    change = _object(winding=_list(number), base=_list(number, 6), flange=_list(number, 6))
    direction = _object(
        coils=_list(change),
        delivered_A_per_A=_list(_list(number)),
        offset_A=_list(number),
        background_T=three,
    )
    free = dict.fromkeys(("sd", "ci90_lower", "ci90_upper"), _or_null(number))
    properties = {
        "format": {"const": "coilcal calibration"},
        "schema_version": {"const": SCHEMA_VERSION},
        "name": text,
        "conventions": _object(
            **{key: {"type": "string", "description": words} for key, words in CONVENTIONS.items()}
        ),
        "origin": {"type": "object", "additionalProperties": {"type": ["string", "null"]}},
        "parameters": {"type": "object", "additionalProperties": _object(value=number, unit=text, **free)},
        "mu0_T_m_per_A": number,
        "coils": _list({"anyOf": coils}),
        "movers": _list(_object(name=text, columns=_list(text, 6), denavit_hartenberg=_or_null(table))),
        "delivered_A_per_A": _list(_list(number)),
        "offset_A": _list(number),
        "background_T": three,
        "directions": _list(direction),
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "calibrated magnet, as coilcal export --to json writes it",
        **_object(**properties),
    }


def _merged(magnet: Magnet, entries_of: Callable[[Calibrated], Mapping[str, Any]]) -> dict[str, Any]:
    """Entries of all calibrations; a key that several have is told apart by the coils of each."""
    each = [(part, entries_of(part)) for part in magnet.parts]
    merged = {}
    for part, entries in each:
        coils = ", ".join(coil.name for coil in part.rig.coils)
        for key, entry in entries.items():
            is_shared = sum(key in others for _, others in each) > 1
            merged[f"{key} ({coils})" if is_shared else key] = entry
    return merged


def _origin(calibrated: Calibrated) -> dict[str, str | None]:
    summary = calibrated.summary_json
    keys = ("session_source", "session_created", "session_hash", "rig_hash")
    return {**{key: str(summary[key]) for key in keys if key in summary}, "code_version": code_version()}


def _parameters(calibrated: Calibrated) -> dict[str, dict[str, Any]]:
    """Every number of the rig: best value, and the width of its posterior where it was free."""
    parameters = {}
    for name, parameter in calibrated.rig.parameters.items():
        draws = calibrated.draws.get(name)
        ends = (
            [None] * 3 if draws is None else [float(draws.std()), *np.quantile(draws, (0.05, 0.95)).tolist()]
        )
        widths = dict(zip(("sd", "ci90_lower", "ci90_upper"), ends, strict=True))
        parameters[name] = {"value": calibrated.best[name], "unit": parameter.unit, **widths}
    return parameters


def _coil(coil: PlainCoil, region_m: Tensor, movers: tuple[PlainMover, ...]) -> dict[str, Any]:
    rules = [
        {
            "steps": rule.steps,
            "axial_nodes": rule.axial.nodes.tolist(),
            "axial_weights": rule.axial.weights.tolist(),
            "radial_nodes": rule.radial.nodes.tolist(),
            "radial_weights": rule.radial.weights.tolist(),
        }
        for rule in coil.rules
    ]
    return {
        "name": coil.name,
        "mover": movers[coil.mover].name if coil.mover >= 0 else None,
        **_corners(coil.winding),
        **{key: float(number) for key, number in numbers_of(coil.winding).items()},
        "world_from_base": _pose(coil.world_from_base),
        "flange_from_coil": _pose(coil.flange_from_coil),
        "first_level": coil.first_level,
        "rule_of_level": list(coil.rule_of_level),
        "rules": rules,
        "leads_m": [list(map(list, piece)) for piece in coil.leads],
        "measured_low_m": region_m.amin(0).tolist() if len(region_m) else None,
        "measured_high_m": region_m.amax(0).tolist() if len(region_m) else None,
    }


def _corners(winding: AnyWinding) -> dict[str, str]:
    if isinstance(winding, Winding):
        return {}
    return {"corners": "round" if winding.is_rounded else "sharp"}


def _mover(mover: PlainMover) -> dict[str, Any]:
    table = mover.joints
    keys = ("theta_rad", "a_m", "d_m", "alpha_rad")
    joints = {key: list(getattr(table, key)) for key in keys} if table is not None else None
    return {"name": mover.name, "columns": list(mover.columns), "denavit_hartenberg": joints}


def _directions(changes: Linearised) -> list[dict[str, Any]]:
    return [
        {
            "coils": [
                {key: getattr(coil, key)[k].tolist() for key in ("winding", "base", "flange")}
                for coil in changes.coils
            ],
            "delivered_A_per_A": changes.delivered_A_per_A[k].tolist(),
            "offset_A": changes.offset_A[k].tolist(),
            "background_T": changes.background_T[k].tolist(),
        }
        for k in range(changes.n_directions)
    ]


def _pose(pose: Transform) -> dict[str, Any]:
    return {"translation_m": pose.translation_m.tolist(), "rotation": pose.rotation.tolist()}


def _object(**properties: Any) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def _list(items: dict[str, Any], count: int | None = None) -> dict[str, Any]:
    length = {} if count is None else {"minItems": count, "maxItems": count}
    return {"type": "array", "items": items, **length}


def _or_null(schema: dict[str, Any]) -> dict[str, Any]:
    return {"anyOf": [schema, {"type": "null"}]}
