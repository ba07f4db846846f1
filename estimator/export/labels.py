"""What an exported file says of itself: names that any language takes, where it was measured, and what it was made from."""

from __future__ import annotations

import re

from jaxtyping import Float

from estimator.code_version import code_version
from estimator.export.calibrated import Calibrated
from estimator.geometry.motion import base_from_motion, world_from_body
from estimator.rig.bodies import AnyCoil
from estimator.tensors import Tensor, torch

LONGEST_NAME = 40  # MATLAB takes 63 characters, prefix included


def identifier(name: str) -> str:
    """A name as programs write it.

    Examples:
        >>> identifier("two arms (B)"), identifier("µ-coil 3")
        ('two_arms_B', 'coil_3')
    """
    return re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")[:LONGEST_NAME] or "magnet"


def plain_words(text: str) -> str:
    r"""Text that may stand in a comment of any language.

    Examples:
        >>> plain_words("coil */ of the \n second room")
        'coil of the second room'
    """
    return re.sub(r"[^\w.,:()+-]+", " ", text).strip()


def caution_of(calibrated: Calibrated) -> str:
    """Why a calibration is not good, with what that means for its intervals; empty where it is good or was never judged."""
    quality = calibrated.summary_json.get("quality", {})
    if quality.get("verdict", "good") == "good":
        return ""
    return f"{quality['verdict']}: {quality['reasons'][0]} Intervals hold only if nothing is wrong."


def regions_of(calibrated: Calibrated) -> list[str]:
    """Extent of the readings about each coil, in mm in the coil's frame, and why the calibration is not good: a sentence each."""
    caution = plain_words(caution_of(calibrated))
    lines = [f"the calibration is {caution}"] if caution else []
    for coil in calibrated.rig.coils:
        points_m = points_about(calibrated, coil)
        if len(points_m):
            low, high = 1e3 * points_m.amin(0), 1e3 * points_m.amax(0)
            spans = (
                f"{axis} {a:.0f} to {b:.0f}"
                for axis, a, b in zip("xyz", low.tolist(), high.tolist(), strict=True)
            )
            lines.append(f"readings about {coil.name} lay at {', '.join(spans)} mm in its frame.")
    return lines if len(lines) > bool(caution) else [*lines, "it was made from no readings."]


def points_about(calibrated: Calibrated, coil: AnyCoil) -> Float[Tensor, "reading 3"]:
    """Positions of the sensors in the frame of a coil, at readings with current in it."""
    rig, readings = calibrated.rig, calibrated.observations
    values = calibrated.best_values()
    is_on = readings.current_A[:, rig.coils.index(coil)] != 0.0
    flange = {mover.name: base_from_motion(mover, readings.motion[mover.name]) for mover in rig.movers}
    coil_from_world = world_from_body(rig, coil, "coil", flange, values).inverse()
    parts = []
    for number, sensor in enumerate(rig.sensors):
        in_coil = coil_from_world @ world_from_body(rig, sensor, "sensor", flange, values)
        points_m = in_coil.translation_m.expand(len(readings), 3)
        parts.append(points_m[is_on & (readings.sensor == number)])
    return torch.cat(parts)


def origin_of(calibrated: Calibrated) -> str:
    """Session, rig and code behind a calibration, in one line."""
    summary = calibrated.summary_json
    hashes = [
        f"{key.replace('_', ' ')} {str(summary[key])[:12]}"
        for key in ("session_hash", "rig_hash")
        if key in summary
    ]
    return plain_words(", ".join(["coilcal calibration", *hashes, f"exported by code {code_version()}"]))
