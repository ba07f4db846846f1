"""In which link of the chain of measurement each hidden cause sits, and which causes coilcal's list holds; fixed, whatever it learns.

A cause may have several links: an honest physicist who saw the readings would accept any of them. A time-dependent turn of the coil,
for instance, may come from what carries it or from how it is mounted. With one sensor further links cannot be told apart, to the last
digit: a common factor of all readings in time is the current's or the sensor's, a uniform field in time the room's or the sensor's zero.
"""

from __future__ import annotations

LINKS = ("current", "winding", "room", "mover", "mount", "response", "zero")

# Causes that no list holds.
LINK: dict[str, tuple[str, ...]] = {
    "eddy_lag": ("room", "response"),
    "sheared_ellipse": ("winding",),
    "gravity_droop": ("mover",),
    "screw_pitch_error": ("mover",),
    "arm_warming": ("mover", "mount"),
    "overshoot": ("mover",),
    "cable_pull": ("mount", "mover"),
    "table_sag": ("mount", "mover"),
    "creeping_clamp": ("mount", "response"),
    "winding_creep": ("winding", "mount"),
    "soft_limit": ("current",),
    "polarity_gain": ("current",),
    "loose_connector": ("current",),
    "barkhausen_jumps": ("winding", "current"),
    "current_crosstalk": ("zero", "current"),
    "tram_walk": ("room",),
    "tool_left": ("room",),
    "chair_moved": ("room",),
    "adc_ripple": ("response",),
    "adc_carry": ("response",),
    "late_trigger": ("response", "mover"),
    "offset_memory": ("zero", "response"),
    "directional_gain": ("response",),
    "supply_hunting": ("current",),
    "warped_former": ("winding",),
    "field_cancellation": ("room",),
    "coiled_cable": ("room",),
    "rocking_mount": ("mount", "mover"),
    "warm_stand": ("mount", "mover"),
    "coarse_range": ("response",),
    "clocks_apart": ("response", "mover"),
    "compressor_dips": ("current",),
    "flexing_cable": ("current",),
    "tapered_former": ("winding",),
    "warm_short": ("winding", "current"),
    "remembering_bolt": ("room",),
    "neighbour_ramp": ("room",),
    "lost_steps": ("mover",),
    "frame_breathing": ("mover",),
    "warm_mount": ("mount", "mover"),
    "toggling_probe": ("mount",),
    "warmup_gain": ("response",),
    "autozero_jumps": ("zero",),
}

# Causes of coilcal's list that sessions hide at a visible size.
LINK_OF_LISTED: dict[str, tuple[str, ...]] = {
    "current_gain": ("current", "winding"),
    "current_offset": ("current",),
    "coil_heating": ("current",),
    "current_step": ("current", "winding"),
    "current_remanence": ("current", "winding"),
    "current_spell": ("current",),
    "axial_pitch": ("winding",),
    "radial_pitch": ("winding",),
    "turns_gradient": ("winding",),
    "short_layer": ("winding",),
    "coil_ovality": ("winding",),
    "lead_wire": ("winding",),
    "spherical_sum": ("winding",),
    "winding_misstated": ("winding",),
    "hidden_winding": ("winding",),
    "reversed_layer": ("winding",),
    "background_field": ("room",),
    "background_drift": ("room",),
    "background_spell": ("room",),
    "periodic_interference": ("room",),
    "iron_plate": ("room",),
    "iron_body": ("room",),
    "second_iron_body": ("room",),
    "magnetised_link": ("winding", "mover", "mount"),
    "neighbour_coil": ("room", "current"),
    "robot_scale": ("mover",),
    "robot_shear": ("mover",),
    "position_lag": ("mover",),
    "backlash": ("mover",),
    "joint_zeros": ("mover",),
    "base_misplaced": ("mover", "mount"),
    "mover_slipped": ("mover",),
    "mount_tilt": ("mount",),
    "coil_misplaced": ("mount",),
    "sensor_misplaced": ("mount",),
    "sensor_bumped": ("mount",),
    "element_displacement": ("mount", "response"),
    "axis_gain": ("response",),
    "cross_axis": ("response", "mount"),
    "gain_spell": ("response",),
    "cubic_response": ("response",),
    "planar_hall": ("response",),
    "range_clipping": ("response",),
    "temperature_drift": ("response",),
    "thermal_lag": ("response",),
    "sensor_lag": ("response",),
    "channel_crosstalk": ("response", "zero"),
    "sensor_exchanged": ("response", "zero"),
    "sensor_offset": ("zero",),
    "offset_drift": ("zero",),
}

# Departures by which coilcal corrects what no cause of its list explains; by their names.
LINK_OF_DEPARTURE: dict[str, str] = {
    **dict.fromkeys(("current_wanders", "current_swings", "current_steps", "current_remembered"), "current"),
    **dict.fromkeys(("coil_harmonics", "coil_multipoles", "coil_bore"), "winding"),
    **dict.fromkeys(("room_harmonics", "room_bore", "room_answers", "room_wanders", "room_steps"), "room"),
    **dict.fromkeys(("guide_errors", "guides_wander", "guide_swings", "guides_step"), "mover"),
    **dict.fromkeys(("moves_remembered", "sides_remembered", "stop_errors"), "mover"),
    **dict.fromkeys(("turns_wander", "turns_by_angle"), "mount"),
    **dict.fromkeys(("sensor_response", "response_by_place", "response_wanders"), "response"),
    **dict.fromkeys(("axis_curves", "gain_curve", "axis_steps", "gain_steps"), "response"),
    **dict.fromkeys(("reading_ripples", "response_steps", "field_remembered"), "response"),
    **dict.fromkeys(("zero_wanders", "zero_swings", "zero_steps", "current_pickup"), "zero"),
}

# Causes that the list holds under another name, to the last digit or nearly so: no mixed session hides them as unlisted.
UNDER_ANOTHER_NAME = {"polarity_gain": "current_asymmetry", "soft_limit": "current_compression"}
WITH_ONE_SENSOR_UNDER_ANOTHER_NAME = {"tool_left": "background_spell"}
# At 30 sigma one listed cause leaves 2.8 and 3.8 of these; they were found when others were drawn already, so a draw of one is void.
WITH_ONE_SENSOR_NEARLY = {"remembering_bolt": "background_step", "neighbour_ramp": "periodic_interference"}

UNLISTED, LISTED = tuple(LINK), tuple(LINK_OF_LISTED)

# What one sensor alone cannot tell from the links above.
WITH_ONE_SENSOR: dict[str, tuple[str, ...]] = {
    # a uniform or steady field in time
    "tram_walk": ("zero",),
    "tool_left": ("zero",),
    "remembering_bolt": ("zero",),
    "neighbour_ramp": ("zero",),
    "autozero_jumps": ("room",),
    "background_field": ("zero",),
    "background_drift": ("zero",),
    "background_spell": ("zero",),
    "periodic_interference": ("zero",),
    "sensor_offset": ("room",),
    "offset_drift": ("room",),
    # a common factor in time or by place
    "supply_hunting": ("response",),
    "loose_connector": ("response",),
    "barkhausen_jumps": ("response",),
    "compressor_dips": ("response",),
    "flexing_cable": ("response",),
    "warmup_gain": ("current",),
    "current_step": ("response",),
    "current_spell": ("response",),
    "coil_heating": ("response",),
    "temperature_drift": ("current",),
    "thermal_lag": ("current",),
    # the only sensor moves, or the coil does
    "toggling_probe": ("mover",),
    "sensor_bumped": ("mover",),
}


def links_of(name: str, n_sensors: int) -> tuple[str, ...]:
    """Links that a diagnosis may name for a hidden cause, its own first; empty for a cause of no table."""
    own = LINK.get(name) or LINK_OF_LISTED.get(name, ())
    return own + (WITH_ONE_SENSOR.get(name, ()) if n_sensors == 1 else ())
