"""A Python module that makes a magpylib collection of a calibrated magnet, loop by loop, with its movers at rest."""

from __future__ import annotations

import json
from typing import Any

from estimator.errors import InvalidInput
from estimator.export.labels import plain_words
from estimator.export.plain_model import numbers_of
from estimator.export.request import Request, motion_of
from estimator.rig.bodies import SidedCoil
from estimator.tensors import torch

CHORDS_PER_ARC = 90
CHORDS = f" Arcs are {CHORDS_PER_ARC} chords each."

MODULE = '''"""Calibrated magnet "{title}" as a magpylib collection.

`magnet({currents}).getB(points_m)` is the field in tesla in the world frame of the rig file, for commanded currents of {names} in ampere.
Every loop of a winding is a circle or a closed line, so that the field is that of the loops, which `coilcal predict` sums to 1e-6.{chords}
Poses are those at: {poses}.
{regions}
{origin}
"""

import magpylib
import numpy as np
from scipy.spatial.transform import Rotation

COILS = {coils}
DELIVERED_A_PER_A = np.array({delivered})
OFFSET_A = np.array({offset})
BACKGROUND_T = np.array({background})


def magnet(currents_A):
    """The collection at these commanded currents: one collection of loops for each coil, and the uniform field of the room."""
    delivered_A = DELIVERED_A_PER_A @ np.asarray(currents_A, dtype=float) + OFFSET_A
    return magpylib.Collection([winding(*each) for each in zip(COILS, delivered_A)] + [room()])


def winding(coil, current_A):
    """The loops of a coil in their places."""
    axial = coil["axial_pitch_m"] * (np.arange(round(coil["axial_loops"])) - coil["axial_loops"] + 0.5)
    outwards = coil["radial_pitch_m"] * (np.arange(round(coil["radial_loops"])) + 0.5)
    loops = [loop(coil, out_m, current_A).move((0.0, 0.0, height_m)) for height_m in axial for out_m in outwards]
    leads = [magpylib.current.Polyline(vertices=piece, current=current_A) for piece in coil["leads_m"]]
    collection = magpylib.Collection(loops + leads, style_label=coil["name"])
    collection.rotate(Rotation.from_matrix(coil["rotation"]), anchor=(0.0, 0.0, 0.0))
    return collection.move(coil["translation_m"])


def loop(coil, out_m, current_A):
    """A round loop below the outer radius, or one with straight sides and arcs of chords outside the bore."""
    if "radius_m" in coil:
        return magpylib.current.Circle(diameter=2.0 * (coil["radius_m"] - out_m), current=current_A)
    radius_m = coil["corner_radius_m"] + out_m if coil["is_rounded"] else 0.0
    middle_x, middle_y = (0.5 * coil["side_" + axis + "_m"] + out_m - radius_m for axis in "xy")
    corners = []
    for quarter, (right, back) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        angles = 0.5 * np.pi * (quarter + np.linspace(0.0, 1.0, {per_arc} + 1 if coil["is_rounded"] else 1))
        corners += [(right * middle_x + radius_m * np.cos(a), back * middle_y + radius_m * np.sin(a), 0.0) for a in angles]
    return magpylib.current.Polyline(vertices=[*corners, corners[0]], current=current_A)


def room():
    """The uniform field that is there without currents."""

    def field(field, observers):
        scale = {{"B": 1.0, "H": 1.0 / magpylib.mu_0}}.get(field)
        return None if scale is None else np.tile(scale * BACKGROUND_T, (len(observers), 1))

    return magpylib.misc.CustomSource(field_func=field, style_label="room")
'''


def magpylib_module(request: Request) -> str:
    """The text of the module; a mover that reports displacements stands at zeros where it has no motion.

    Raises:
        InvalidInput: A mover without its motion, a count of loops that is not whole, or a rig with something that loops cannot express.
    """
    magnet, motion = request.magnet, request.motion
    model = magnet.model("magpylib")
    origin_m = torch.zeros(1, 3, dtype=torch.float64)
    coils: list[dict[str, Any]] = []
    for plain in model.coils:
        part, coil = magnet.home[plain.name]
        sources = part.room(origin_m, motion_of(part, motion)).sources
        numbers = {key: float(number) for key, number in numbers_of(plain.winding).items()}
        for key in ("axial_loops", "radial_loops"):
            if not numbers[key].is_integer():
                raise InvalidInput(
                    f"export to magpylib must have whole loops; {coil.name}.{key} is {numbers[key]:g}"
                )
        pose = sources.world_from_body(coil, "coil", torch.zeros(1, dtype=torch.int64), part.best_values())
        rotation, translation_m = pose.rotation.reshape(3, 3).tolist(), pose.translation_m.reshape(3).tolist()
        corners = {"is_rounded": int(coil.is_rounded)} if isinstance(coil, SidedCoil) else {}
        coils.append(
            {"name": coil.name, **corners, **numbers, "leads_m": plain.leads}
            | {"rotation": rotation, "translation_m": translation_m}
        )
    poses = ", ".join(f"{name} {[round(x, 6) for x in row.tolist()]}" for name, row in motion.items())
    return MODULE.format(
        chords=CHORDS if any(coil.get("is_rounded") for coil in coils) else "",
        per_arc=CHORDS_PER_ARC,
        title=plain_words(model.name),
        currents=[1.0] * len(coils),
        names=", ".join(coil.name for coil in model.coils),
        poses=poses or "rest",
        regions="\n".join(line[:1].upper() + line[1:] for line in magnet.regions),
        origin=magnet.origin,
        coils=json.dumps(coils, indent=4),
        delivered=model.delivered_A_per_A.tolist(),
        offset=model.offset_A.tolist(),
        background=model.background_T.tolist(),
    )
