"""A Python module that makes a magpylib collection of a calibrated magnet, loop by loop, with its movers at rest."""

from __future__ import annotations

import json
from typing import Any

from estimator.errors import InvalidInput
from estimator.export.labels import plain_words
from estimator.export.plain_model import numbers_of
from estimator.export.request import Request, motion_of
from estimator.export.templates import template
from estimator.rig.bodies import SidedCoil
from estimator.tensors import torch

CHORDS_PER_ARC = 90
CHORDS = f" Arcs are {CHORDS_PER_ARC} chords each."


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
    return template("magpylib_module.py.j2", {}).render(
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
