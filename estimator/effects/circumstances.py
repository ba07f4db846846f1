"""Circumstances of every reading: its time, currents and poses, and what a session is like as a whole."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from jaxtyping import Bool, Float, Int

from estimator.effects.history import History
from estimator.frames import Transform
from estimator.geometry.motion import base_from_motion, nominal_positions_m, pose_of, world_from_body
from estimator.readings.observations import SECONDS_PER_HOUR
from estimator.readings.segments import NO_SEGMENT
from estimator.rig.bodies import AnyCoil, Sensor
from estimator.rig.coordinates import nominal_tensors
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

N_INSTANTS = 24  # at which something may have happened
SINCE, UNTIL = "since_h", "until_h"  # keys of the instants at which something begins and ends
EVERY = 2  # of these, where starts would be too many: half a gap beside the truth, they still stand out


@dataclass(frozen=True)
class Extent:
    """Duration, strength, width and middle of a session, the time between readings, and its segments.

    The priors of some causes scale with them, and what was set up anew has quantities for each segment. A correction has quantities up to a
    degree, which is chosen for it.
    """

    duration_h: float = 1.0
    largest_current_A: float = 1.0
    largest_field_T: float = 1.0
    reach_m: float = 1.0
    middle_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    interval_h: float = 0.01
    segments: tuple[int, ...] = (0, 1)
    degree: int = 2

    def frequencies_per_h(self, most: int) -> tuple[float, int]:
        """Spacing of the frequencies that are looked for in time, half a cycle per session, which is the lowest too, and their number.

        Farther apart, starts would miss swings between them. Beyond half a cycle between readings they repeat.
        """
        return 0.5 / self.duration_h, max(1, min(int(self.duration_h / self.interval_h), most))


class Circumstances(History):
    """The circumstances of some readings of a session: bodies, times, and what the priors and starts of causes depend on."""

    def __len__(self) -> int:
        return len(self.observations)

    def with_effects_of(self, rig: Rig) -> Circumstances:
        """These circumstances for a rig that differs in its effects alone; what is known of the session stays known."""
        other = Circumstances(rig, self.observations)
        known = {name: value for name, value in self.__dict__.items() if name not in ("rig", "observations")}
        other.__dict__.update(known)
        return other

    @property
    def of_history(self) -> Circumstances:
        """Circumstances of all readings of the session."""
        return Circumstances(self.rig, self.observations.history)

    @property
    def sensor(self) -> Int[Tensor, " reading"]:
        """Index of the sensor of each reading."""
        return self.observations.sensor

    @property
    def current_A(self) -> Float[Tensor, "reading coil"]:
        """Commanded currents."""
        return self.observations.current_A

    def is_of(self, sensor: str) -> Bool[Tensor, " reading"]:
        """Readings of one sensor."""
        return self.sensor == self.sensor_number(sensor)

    def has_current(self, coil: str) -> bool:
        """Whether a coil was to carry current at any reading."""
        return bool((self.current_A[:, self.coil_number(coil)] != 0.0).any())

    def commanded_A(self, coil: str) -> Float[Tensor, " history"]:
        """Commanded current of one coil at each reading of the whole session."""
        return self.observations.history.current_A[:, self.coil_number(coil)]

    def winding_m(self, coil: str) -> tuple[float, float, float]:
        """External radius, radius of the bore, and length of a round winding as the rig file describes it."""
        nominal = self.rig.nominal_values()
        length_m, thickness_m = (
            nominal[f"{coil}.{way}_loops"] * nominal[f"{coil}.{way}_pitch_m"] for way in ("axial", "radial")
        )
        radius_m = nominal[f"{coil}.radius_m"]
        return radius_m, radius_m - thickness_m, length_m

    def has_sensor_in_bore(self, coil: str) -> bool:
        """Whether a sensor stood in the bore of a winding, as the rig file describes it; only a round winding is asked."""
        by_name = {each.name: each for each in self.rig.round}
        if coil not in by_name:
            return False
        _, bore_m, length_m = self.winding_m(coil)
        coil_from_world = self.world_from(by_name[coil]).inverse()
        for sensor in self.rig.sensors:
            at_m = (coil_from_world @ self.world_from(sensor)).translation_m
            at_m = at_m[self.is_of(sensor.name)] if len(at_m) == len(self) else at_m
            is_in = (at_m[..., :2].norm(dim=-1) < bore_m) & (at_m[..., 2] < 0.0) & (at_m[..., 2] > -length_m)
            if bool(is_in.any()):
                return True
        return False

    def world_from(self, body: AnyCoil | Sensor) -> Transform:
        """Pose of a body at each reading, or one for all where it stands still, as the rig file describes it."""
        values, flange = self._nominal
        kind = "sensor" if isinstance(body, Sensor) else "coil"
        return world_from_body(self.rig, body, kind, flange, values)

    def world_from_base(self, mover: str) -> Transform:
        """Pose of the base of a mover, as the rig file describes it."""
        return pose_of(f"{mover}.world_from_base", self._nominal[0])

    @cached_property
    def _nominal(self) -> tuple[dict[str, Tensor], dict[str, Transform]]:
        """Nominal values of the rig, and pose of each mover's flange in its base."""
        motion = self.observations.motion
        return nominal_tensors(self.rig, self.current_A), {
            mover.name: base_from_motion(mover, motion[mover.name]) for mover in self.rig.movers
        }

    def has_turned_back(self, coil: str) -> bool:
        """Whether the current of a coil has turned back."""
        return bool(self.last_turn_A(self.coil_number(coil)).any())

    @cached_property
    def largest_field_T(self) -> float:
        """Largest component that was read in the session."""
        return max(float(self.observations.history.field_sensor_T.nan_to_num().abs().max()), 1e-9)

    def largest_of_sensor_T(self, sensor: str) -> float:
        """Largest component that one sensor read in the session."""
        history = self.observations.history
        is_sensor = history.sensor == self.sensor_number(sensor)
        shown_T = history.field_sensor_T[is_sensor].nan_to_num().abs().flatten()
        return max(float(shown_T.max()), 1e-9) if len(shown_T) else 1e-9

    @cached_property
    def positions_m(self) -> Float[Tensor, "position 3"]:
        """Nominal world positions of coils and sensors, a few hundred poses of each at most."""
        return nominal_positions_m(self.rig, self.observations.history)

    @cached_property
    def sensor_positions_m(self) -> Float[Tensor, "position 3"]:
        """Nominal world positions of the sensors alone."""
        return nominal_positions_m(self.rig, self.observations.history, has_coils=False)

    @cached_property
    def reach_m(self) -> float:
        """Largest distance of a coil or sensor from the mean of their positions."""
        return float((self.positions_m - self.positions_m.mean(0)).norm(dim=-1).max())

    @cached_property
    def extent(self) -> Extent:
        """Duration, strength, width and middle of the session, the time between readings, and its segments."""
        x, y, z = self.positions_m.mean(0).tolist()
        middle_m = (x, y, z)
        strength = self.largest_current_A, self.largest_field_T
        return Extent(self.duration_h, *strength, self.reach_m, middle_m, self.interval_h, self.segments_of())

    def frequencies(self, most: int) -> tuple[dict[str, float], ...]:
        """Frequencies that are looked for in time, from half a cycle per session on, half a cycle apart."""
        spacing, n = self.extent.frequencies_per_h(most)
        return tuple({"frequency_per_h": (i + 1) * spacing} for i in range(n))

    @property
    def segment(self) -> Int[Tensor, " reading"]:
        """Number of the segment of each reading; `NO_SEGMENT` outside any."""
        return self.observations.segment

    def segments_of(self, sensor: str | None = None) -> tuple[int, ...]:
        """Numbers of the session's segments, or of those in which one sensor was read."""
        history = self.observations.history
        numbers = history.segment
        if sensor is not None:
            numbers = numbers[history.sensor == self.sensor_number(sensor)]
        return tuple(numbers[numbers != NO_SEGMENT].unique().tolist())

    @cached_property
    def hours(self) -> Float[Tensor, " reading"]:
        """Time since the session began."""
        time_s = self.observations.time_s - self.observations.history.time_s.min()
        return (time_s / SECONDS_PER_HOUR).to(self.observations.dtype)

    @property
    def is_moment(self) -> bool:
        """Whether all readings of the session were taken at once."""
        time_s = self.observations.history.time_s
        return bool(time_s.max() == time_s.min())

    @cached_property
    def hours_for_instants(self) -> Float[Tensor, " reading"]:
        """Time since the session began; where a single moment stands for a session, before any instant of it."""
        return torch.full_like(self.hours, -1.0) if self.is_moment else self.hours

    @cached_property
    def interval_h(self) -> float:
        """Median time from one reading to the next; the duration where all were taken at once."""
        steps_s = self.observations.history.time_s.unique().diff()
        return float(steps_s.median()) / SECONDS_PER_HOUR if len(steps_s) else self.duration_h

    @cached_property
    def instants_h(self) -> tuple[float, ...]:
        """Instants between readings, spread over the session, from which on something may be otherwise."""
        time_h = self.history_h
        spread = torch.linspace(0, len(time_h) - 1, N_INSTANTS + 2, device=time_h.device)
        rows = spread.round().long()[1:-1].unique()
        rows = rows[rows > 0]
        return tuple((0.5 * (time_h[rows - 1] + time_h[rows])).tolist())

    @property
    def coarse_instants_h(self) -> tuple[float, ...]:
        """Every other one of these instants, for causes that would have too many starts."""
        return self.instants_h[::EVERY]

    def is_since(self, instant_h: Float[Tensor, "*batch"]) -> Bool[Tensor, "*batch reading"]:
        """Readings from an instant on."""
        return self.hours >= instant_h[..., None]

    def positions_of_m(self, mover: str) -> Float[Tensor, "reading 3"]:
        """Reported positions of a mover."""
        motion = self.observations.motion[mover]
        return base_from_motion(self.rig.mover(mover), motion).translation_m

    def mover_of_sensor_m(self, sensor: str) -> Float[Tensor, "reading 3"] | None:
        """Reported positions of the mover that carries a sensor, else of the first that carries a coil; None where nothing moves."""
        own = self.rig.sensors[self.sensor_number(sensor)].carried_by
        mover = own or next((coil.carried_by for coil in self.rig.coils if coil.carried_by is not None), None)
        if mover is None:
            return None
        return self.positions_of_m(mover)

    def moved_between(self, sensor: str) -> bool:
        """Whether that mover moved from one reading of the sensor to another."""
        at_m = self.mover_of_sensor_m(sensor)
        if at_m is None:
            return False
        own_m = at_m[self.is_of(sensor)]
        return bool((own_m != own_m[:1]).any())


def is_meanwhile(
    hours: Float[Tensor, " reading"], theta: Mapping[str, Tensor]
) -> Bool[Tensor, "*batch reading"]:
    """Readings from the instant on at which something begins, and before that at which it ends, where it ends.

    Args:
        hours: Time of each reading since the session began, in h.
        theta: Quantities of the cause, `since_h` and perhaps `until_h` among them, in h.

    Examples:
        >>> one, three = torch.tensor(1.0), torch.tensor(3.0)
        >>> is_meanwhile(torch.arange(5.0), {"since_h": one}).tolist()
        [False, True, True, True, True]
        >>> is_meanwhile(torch.arange(5.0), {"since_h": one, "until_h": three}).tolist()
        [False, True, True, False, False]
    """
    has_begun = hours >= theta[SINCE][..., None]
    return has_begun & (hours < theta[UNTIL][..., None]) if UNTIL in theta else has_begun
