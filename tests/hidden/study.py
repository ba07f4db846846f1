"""Cases of the hidden-effect study: what is hidden, and how a verdict is compared with it."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from typing import Any

import numpy as np

from tests.hidden.handed_in import HiddenSession
from tests.hidden.library import UNFORESEEN, names
from tests.hidden.mixed_session import draw_mixed_session
from tests.hidden.open_session import draw_open_session, within
from tests.hidden.session import draw_session

FIRST_KINDS = ("single", "clean", "pair", "outside", "discrete")
KINDS = (*FIRST_KINDS, "iron")  # new ones at the end: seeds count them
IRON = ("iron_body", "iron_plate", "second_iron_body", "magnetised_link")
OPEN_KINDS = (
    "open",
    "clean_open",
    "unknown8",
    "unknown12",
    "unknown30",
    "unforeseen30",
    "unforeseen12",
)  # new ones at the end: seeds count them
MIXED_KINDS = (
    "mixed",
    "mixed_two",
)  # with one and two unlisted causes; new ones at the end: seeds count them
KNOWN_SHARE, NATURAL_SIGMA = 0.7, (4.0, 40.0)  # of kind `open`
PROTOCOLS = ("paper", "recommended")
SIGMA = 8.0
DISCRETE = ("axes_swapped", "unit_error", "left_handed", "displacement_frame", "current_sign")
MOST_TRIES = 40
Translation = Callable[[dict[str, float]], dict[str, float]]


def draw_case(kind: str, seed: int, library: Collection[str] = ()) -> HiddenSession:
    """A session of a kind; all about it is drawn from the seed.

    Args:
        kind: One of `KINDS`, `OPEN_KINDS` or `MIXED_KINDS`.
        library: Names of the causes that coilcal knows; the kinds of the open world depend on them.
    """
    if kind in MIXED_KINDS:
        number = MIXED_KINDS.index(kind)
        return draw_mixed_session([994, number], seed, n_unlisted=1 + number)
    if kind in OPEN_KINDS:
        return _draw_open(kind, seed, library)
    rng = np.random.default_rng([991, KINDS.index(kind), seed])
    protocol = PROTOCOLS[int(rng.integers(2))]
    for _ in range(MOST_TRIES):
        causes: tuple[str, ...] = ()
        if kind == "single":
            causes = (str(rng.choice(names(protocol))),)
        elif kind == "pair":
            causes = tuple(str(one) for one in rng.choice(names(protocol), 2, replace=False))
        elif kind == "outside":
            causes = (str(rng.choice(names(protocol, is_known=False))),)
        elif kind == "discrete":
            causes = (str(rng.choice(DISCRETE)),)
        elif kind == "iron":
            causes = (str(rng.choice(IRON)),)
        try:
            return draw_session(seed, causes, SIGMA, protocol)
        except ValueError:
            continue  # the cause cannot become visible in this session
    raise RuntimeError(f"no {kind} session for seed {seed}")


def _draw_open(kind: str, seed: int, library: Collection[str]) -> HiddenSession:
    number = OPEN_KINDS.index(kind)
    rng = np.random.default_rng([992, number, seed])
    is_known, sigma = False, float(np.exp(rng.uniform(*np.log(NATURAL_SIGMA))))
    if kind == "open":
        is_known = bool(rng.random() < KNOWN_SHARE)
    elif kind != "clean_open":
        sigma = float(kind.removeprefix("unknown").removeprefix("unforeseen"))
    choice = None if kind == "clean_open" else within(library, is_known=is_known)
    if kind.startswith("unforeseen"):  # each of them as often, whatever the library has learnt
        choice = within((str(rng.choice(UNFORESEEN)),), is_known=True)
    return draw_open_session([993, number], choice, sigma, seed)


def label(cause: dict[str, Any]) -> str:
    """Name of a true cause as the diagnosis would write it, without its place."""
    return str(cause["name"])


def credible_sets(row: dict[str, Any]) -> list[list[str]]:
    """Of every cause that was named, the names in its 95 % credible set, without places."""
    sets = []
    for cause in row["causes"]:
        members = [cause["name"], *(other["name"] for other in cause["alternatives"])]
        sets.append(
            sorted(
                {name.partition("[")[0] for name in members}, key=[m.partition("[")[0] for m in members].index
            )
        )
    return sets


def is_relative(name: str, truth: str) -> bool:
    """Whether a name that is not the truth says the same of it in other words: the same part moves or bends, in a like way."""
    return name in RELATIVES.get(truth, ())


def is_same(name: str, truth: str) -> bool:
    """Whether a name is that of a hidden cause, or of one that is the same to the last digit: a displaced coil that is turned."""
    return name == truth or (truth, name) == ("coil_misplaced", "mount_tilt")


def true_quantities(cause: dict[str, Any]) -> dict[str, float]:
    """What a diagnosis should find for the numbers of a true cause, by the keys of `diagnosis.json`; those without a counterpart left out."""
    known = {name: one["value"] for name, one in cause["parameters"].items()}
    if cause["name"] == "sensor_bumped" and cause["place"] != "hall":
        return {}  # told in the room's axes, found in those of a sensor that is turned
    translate = TRANSLATED.get(cause["name"])
    return translate(known) if translate else {}


def _with(prefix: str) -> Translation:
    """Those that begin so: `offset_x_T` -> `x_T`."""
    return lambda known: {n.removeprefix(prefix): v for n, v in known.items() if n.startswith(prefix)}


def _per_hour(known: dict[str, float]) -> dict[str, float]:
    return {f"{name[5]}_T_per_h": 3600.0 * value for name, value in known.items()}


# Hidden cause -> names that send the laboratory to the right part.
RELATIVES: dict[str, tuple[str, ...]] = {
    "second_iron_body": ("iron_body", "iron_plate"),
    "chair_moved": ("iron_body", "iron_plate", "second_iron_body"),
    "sheared_ellipse": ("coil_ovality",),
    "magnetised_link": ("background_field",),
    "eddy_lag": ("sensor_lag",),
    "sensor_lag": ("eddy_lag",),
    "sensor_exchanged": ("axis_gain", "cross_axis", "sensor_offset"),
    "thermal_lag": ("temperature_drift",),
    "coil_misplaced": ("mount_tilt", "base_misplaced"),
    "base_misplaced": ("coil_misplaced", "joint_zeros"),
    "joint_zeros": ("base_misplaced", "coil_misplaced"),
    "winding_misstated": ("axial_pitch", "radial_pitch"),
    "axial_pitch": ("winding_misstated",),
    "radial_pitch": ("winding_misstated",),
    "reversed_layer": ("hidden_winding", "short_layer", "radial_pitch"),
    "hidden_winding": ("reversed_layer", "turns_gradient", "short_layer"),
    "gravity_droop": ("robot_scale", "robot_shear"),
    "screw_pitch_error": ("robot_scale", "backlash"),
    "arm_warming": ("robot_scale",),
    "overshoot": ("position_lag", "backlash"),
    "cable_pull": ("mount_tilt", "coil_misplaced", "robot_shear"),
    "table_sag": ("robot_shear", "robot_scale"),
    "creeping_clamp": ("sensor_bumped", "sensor_misplaced"),
    "soft_limit": ("core_saturation", "coil_heating"),
    "polarity_gain": ("current_asymmetry", "current_offset"),
    "loose_connector": ("current_step",),
    "barkhausen_jumps": ("current_step", "current_remanence"),
    "current_crosstalk": ("sensor_offset",),
    "tram_walk": ("background_drift", "periodic_interference", "offset_drift"),
    "tool_left": ("background_field", "background_drift"),
    "adc_ripple": ("cubic_response",),
    "adc_carry": ("cubic_response",),
    "late_trigger": ("sensor_lag",),
    "offset_memory": ("sensor_offset",),
    "directional_gain": ("planar_hall", "cubic_response", "axis_gain", "cross_axis"),
    "warped_former": ("coil_ovality",),
    "coiled_cable": ("neighbour_coil",),
    "rocking_mount": ("backlash",),
    "coarse_range": ("cubic_response",),
    "clocks_apart": ("sensor_lag",),
    "compressor_dips": ("current_step", "current_spell"),
    "flexing_cable": ("current_step",),
    "tapered_former": ("turns_gradient", "winding_misstated", "axial_pitch", "radial_pitch"),
    "warm_short": ("current_step", "current_spell", "short_layer"),
    "remembering_bolt": ("iron_body", "background_step", "background_drift"),
    "neighbour_ramp": ("background_spell", "background_step", "background_drift"),
    "lost_steps": ("mover_slipped", "robot_scale"),
    "frame_breathing": ("robot_scale",),
    "warm_mount": ("mount_tilt", "coil_misplaced"),
    "toggling_probe": ("sensor_bumped", "sensor_misplaced"),
    "warmup_gain": ("thermal_lag", "temperature_drift", "gain_spell"),
    "autozero_jumps": ("offset_step", "offset_spell", "offset_drift", "sensor_offset"),
}

TRANSLATED: dict[str, Translation] = {
    "background_field": _with("background_"),
    "sensor_offset": _with("offset_"),
    "background_drift": _per_hour,
    "offset_drift": _per_hour,
    "sensor_bumped": _with("shift_"),
    "robot_scale": _with("scale_"),
    "robot_shear": _with("shear_"),
    "backlash": _with("play_"),
    "position_lag": lambda known: known,
    "mount_tilt": lambda known: {"x_rad": known["tilt_x_rad"], "y_rad": known["tilt_y_rad"]},
    "axis_gain": lambda known: {name[-1]: value - 1.0 for name, value in known.items()},
    "cross_axis": _with("cross_"),
    "cubic_response": lambda known: {f"{axis}_per_T2": known["cubic_per_T2"] for axis in "xyz"},
    "planar_hall": lambda known: {f"{axis}_per_T": known["planar_per_T"] for axis in "xyz"},
    "range_clipping": lambda known: {"limit_T": known["range_T"]},
    "temperature_drift": lambda known: {"gain_per_K": known["gain_per_K"]},
    "current_offset": lambda known: {"offset_A": known["offset_A"]},
    "neighbour_coil": lambda known: {"share": known["share"]},
    "spherical_sum": lambda known: {"weight": known["share"]},
    "turns_gradient": lambda known: {"gradient": known["gradient"]},
    "iron_body": _with("position_"),
    "coil_ovality": lambda known: {
        "cos2": known["ovality"] * math.cos(2.0 * known["angle_rad"]),
        "sin2": known["ovality"] * math.sin(2.0 * known["angle_rad"]),
    },
}
