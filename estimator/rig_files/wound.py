"""What set-ups of wound coils about one middle share: their answers, and the texts of a rig file and a plan in which a stage maps it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields

from estimator.errors import InvalidInput
from estimator.rig.first import RELATIVE_SD, thickness_at_most
from estimator.rig_files.starter import (
    GAIN,
    N_JUDGED,
    N_POSES,
    SENSOR_COMMENT,
    TILT_SD_DEG,
    Earth,
    check_answer,
    effects,
    head,
    noise,
    normal,
    place,
    tilts,
)

MARGIN_MM = 12.0  # of a place that was measured with a ruler, four times its standard deviation


@dataclass(frozen=True)
class Wound:
    """Answers that all of these set-ups share, in the units of rig files.

    Attributes:
        name: Of the rig.
        wire_radius_mm: Half the distance of neighbouring turns.
        axial_loops, radial_loops: Turns along the axis, and layers, of each coil.
        reach_mm: How far the stage goes to each side.
        noise_uT: Scatter of one component of one reading.
        largest_A: Largest current of each coil.
        earth: Whether readings contain the Earth's field.
    """

    name: str = "my rig"
    wire_radius_mm: float = 0.5
    axial_loops: float = 10.0
    radial_loops: float = 10.0
    reach_mm: float = 40.0
    noise_uT: float = 20.0
    largest_A: float = 3.0
    earth: Earth = Earth.INCLUDED

    def __post_init__(self) -> None:
        for field in fields(self):
            check_answer(field.name, getattr(self, field.name))

    @property
    def thickness_mm(self) -> float:
        """Thickness of the layers, at most."""
        return thickness_at_most(self.wire_radius_mm, self.radial_loops)

    @property
    def length_mm(self) -> float:
        """Length of the winding."""
        return 2.0 * self.wire_radius_mm * self.axial_loops

    def check_bore(self, key: str, inner_mm: float) -> None:
        """Refuse a stage whose sensor would come into a winding.

        Raises:
            InvalidInput: The corners of its way are not inside the bore of this half width.
        """
        room_mm = (inner_mm - MARGIN_MM) / math.sqrt(2.0)
        if room_mm <= 0.0:
            raise InvalidInput(
                f"{key} must leave a bore in which a sensor can be moved, beside layers of {self.thickness_mm:.4g} mm; "
                f"received {getattr(self, key):g}"
            )
        if self.reach_mm > room_mm:
            raise InvalidInput(
                f"reach_mm must be at most {room_mm:.4g}, so that the sensor stays inside the bore; received {self.reach_mm:g}"
            )


def round_coil(
    wound: Wound,
    radius: str,
    middle_mm: float,
    tied_to: str,
    sd_mm: float | None = None,
    frees_turns: bool = False,
) -> str:
    """Lines of a round coil whose middle is on the axis z."""
    face_mm = middle_mm + 0.5 * wound.length_mm
    wire = (
        f"{{tied_to: {tied_to}.wire_radius_m}}"
        if tied_to
        else normal(wound.wire_radius_mm, RELATIVE_SD * wound.wire_radius_mm)
    )
    counts = [
        normal(loops, max(least, RELATIVE_SD * loops), lower=1.0) if frees_turns else f"{loops:g}"
        for loops, least in ((wound.axial_loops, 1.0), (wound.radial_loops, 0.5))
    ]
    z = f"{face_mm:g}" if sd_mm is None else normal(face_mm, sd_mm)
    return (
        f"    radius_mm: {radius}\n    wire_radius_mm: {wire}\n    axial_loops: {counts[0]}\n    radial_loops: {counts[1]}\n"
        "    current_gain: {prior: {normal: {mean: 1, sd: 0.005}}}   # as good as the ammeter\n"
        f"    world_from_coil:         # of its front face, on the axis\n      z_mm: {z}\n"
        + (tilts(TILT_SD_DEG) if sd_mm is not None else "")
    )


def rig_text_of(wound: Wound, words: str, coils: Mapping[str, str]) -> str:
    """The rig file, with comments.

    Args:
        wound: Answers.
        words: What the coils are there for.
        coils: Lines of each.
    """
    bodies = "".join(f"  {name}:\n{lines}" for name, lines in coils.items())
    return f"""\
{head(wound.name)}
movers:                      # robots and stages; readings have six columns of each
  stage:
    # "pose": columns are position and rotation vector of the stage in its own axes; rotations may be left out.
    motion: pose
    world_from_base:         # where its zero is in the room, and how it is turned
{place(6, "xyz", (0.0, 0.0, 0.0))}{tilts(TILT_SD_DEG)}
coils:
  # {words}
  # The middle is the origin of the room. Turns count as known; free them as the other numbers where you have not counted.
{bodies}
sensors:
  hall:
    carried_by: stage
{SENSOR_COMMENT}
    noise_uT: {noise(wound.noise_uT)}
{GAIN}
    flange_from_sensor: {{}}

{effects(("hall",), wound.earth)}"""


def plan_text_of(wound: Wound, settings: Sequence[Mapping[str, float]], depth_mm: float) -> str:
    """The plan, with comments.

    Args:
        wound: Answers.
        settings: Currents of the coils that are set at every pose.
        depth_mm: How far the stage goes along z to each side.
    """
    listed = ", ".join(
        "{" + ", ".join(f"{name}: {value:g}" for name, value in setting.items()) + "}" for setting in settings
    )
    return f"""\
# A plan says which poses to visit with which currents: 'coilcal simulate' makes readings from it, 'coilcal acquire' measures it.
schema_version: 1
name: "first plan of {wound.name}"
poses:
  calibration:               # what a fit sees
    scattered: {N_POSES}            # poses that fill the spans evenly; leave it out for a grid, and give each span a count
    stage:
      x_mm: {{from: {-wound.reach_mm:g}, to: {wound.reach_mm:g}}}
      y_mm: {{from: {-wound.reach_mm:g}, to: {wound.reach_mm:g}}}
      z_mm: {{from: {-depth_mm:g}, to: {depth_mm:g}}}
  validation:                # kept out of every fit, to judge it
    scattered: {N_JUDGED}
    stage:
      x_mm: {{from: {-0.8 * wound.reach_mm:g}, to: {0.8 * wound.reach_mm:g}}}
      y_mm: {{from: {-0.8 * wound.reach_mm:g}, to: {0.8 * wound.reach_mm:g}}}
      z_mm: {{from: {-0.8 * depth_mm:g}, to: {0.8 * depth_mm:g}}}
# Each pose is read with each of these settings, and without current: that tells the coils from the room and from the sensor's zero.
currents_A: [{listed}, {{}}]
order: mixed                 # places and currents at random, which shows drifts
settle_s: 1                  # time from one reading to the next in seconds, 1 where left out
"""


def both_signs(settings: Sequence[Mapping[str, float]]) -> list[dict[str, float]]:
    """Each setting with both signs."""

    def both() -> Iterator[dict[str, float]]:
        for setting in settings:
            for sign in (1.0, -1.0):
                yield {name: sign * value for name, value in setting.items()}

    return list(both())
