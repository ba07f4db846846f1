"""The `effects:` section of a rig file: what it holds, and every mistake in it named by key, rule, value, file and line."""

from __future__ import annotations

import pytest

from estimator.effects import EFFECTS
from estimator.effects.circumstances import Extent
from estimator.errors import InvalidInput
from estimator.rig.parameters import Normal
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.read import rig_from_text

RIG = """\
schema_version: 1
name: small
movers: {arm: {motion: displacement}, ur: {motion: UR3e}}
coils:
  coil: {carried_by: arm, radius_mm: 40, wire_radius_mm: 0.5, axial_loops: 6, radial_loops: 4, superconducting: true}
sensors:
  probe: {noise_uT: 5}
"""  # the effects follow in line 8


def rig_with(effects: str) -> Rig:
    return rig_from_text(RIG + effects, "rig.yaml")


def refusal(effects: str) -> str:
    with pytest.raises(InvalidInput) as caught:
        rig_with(effects)
    return str(caught.value)


REFUSALS = {
    "nothing": ("effects:", 8, "effects must hold keys and values; received None"),
    "list": ("effects: [axis_gain]", 8, "effects must hold keys and values; received ['axis_gain']"),
    "word": ("effects: axis_gain", 8, "effects must hold keys and values; received 'axis_gain'"),
    "unknown cause": ("effects:\n  axis_gian[probe]: {x: 0, y: 0, z: 0}", 9,
        "effects.axis_gian[probe] must be a cause that coilcal knows; received 'axis_gian'; the closest "
        "is axis_gain"),
    "cause in other words": ("effects:\n  earth_field[room]: {x_T: 0, y_T: 0, z_T: 0}", 9,
        "effects.earth_field[room] must be a cause that coilcal knows; received 'earth_field'; 'coilcal "
        "explain' lists them"),
    "no place": ("effects:\n  axis_gain: {x: 0, y: 0, z: 0}", 9,
        "effects.axis_gain must be written as cause[place], such as axis_gain[hall]; received 'axis_gain'"),
    "empty place": ("effects:\n  axis_gain[]: {x: 0, y: 0, z: 0}", 9,
        "effects.axis_gain[] must be written as cause[place], such as axis_gain[hall]; received "
        "'axis_gain[]'"),
    "space before the place": ("effects:\n  axis_gain [probe]: {x: 0, y: 0, z: 0}", 9,
        "effects.axis_gain [probe] must be written as cause[place], such as axis_gain[hall]; received "
        "'axis_gain [probe]'"),
    "unknown place": ("effects:\n  axis_gain[hall]: {x: 0, y: 0, z: 0}", 9,
        "effects.axis_gain[hall] must name one of probe; received 'hall'"),
    "place of another kind": ("effects:\n  axis_gain[coil]: {x: 0, y: 0, z: 0}", 9,
        "effects.axis_gain[coil] must name one of probe; received 'coil'"),
    "room at a coil": ("effects:\n  background_field[coil]: {x_T: 0, y_T: 0, z_T: 0}", 9,
        "effects.background_field[coil] must name one of room; received 'coil'"),
    "displacements of joint angles": ("effects:\n  displacement_frame[ur]: {rx_rad: 0, ry_rad: 0, rz_rad: 0}",
        9, "effects.displacement_frame[ur] must name one of arm; received 'ur'"),
    "unknown quantity": ("effects:\n  axis_gain[probe]: {x: 0, y: 0, z: 0, w: 1}", 9,
        "effects.axis_gain[probe].w is not a known key"),
    "missing quantity": ("effects:\n  axis_gain[probe]: {x: 0, y: 0}", 9,
        "effects.axis_gain[probe].z is missing"),
    "word for a number": ("effects:\n  axis_gain[probe]: {x: big, y: 0, z: 0}", 9,
        "effects.axis_gain[probe].x must be a finite number; received 'big'"),
    "comma in a number": ("effects:\n  axis_gain[probe]:\n    x: 0,1\n    y: 0\n    z: 0", 10,
        "effects.axis_gain[probe].x must be a finite number; received '0,1'"),
    "NaN": ("effects:\n  axis_gain[probe]: {x: .nan, y: 0, z: 0}", 9,
        "effects.axis_gain[probe].x must be a finite number; received nan"),
    "infinite": ("effects:\n  axis_gain[probe]: {x: 0, y: .inf, z: 0}", 9,
        "effects.axis_gain[probe].y must be a finite number; received inf"),
    "list for a number": ("effects:\n  axis_gain[probe]: {x: [1], y: 0, z: 0}", 9,
        "effects.axis_gain[probe].x must be a finite number; received [1]"),
    "yes for a number": ("effects:\n  axis_gain[probe]: {x: yes, y: 0, z: 0}", 9,
        "effects.axis_gain[probe].x must be a finite number; received True"),
    "number for quantities": ("effects:\n  axis_gain[probe]: 0.01", 9,
        "effects.axis_gain[probe] must hold keys and values; received 0.01"),
    "nothing for quantities": ("effects:\n  axis_gain[probe]:", 9,
        "effects.axis_gain[probe] must hold keys and values; received None"),
    "same cause twice": (
        "effects:\n  axis_gain[probe]: {x: 0, y: 0, z: 0}\n  axis_gain[probe]: {x: 1, y: 0, z: 0}", None,
        "effects.axis_gain[probe] must be given once; received it in lines 9 and 10"),
    "same quantity twice": ("effects:\n  axis_gain[probe]:\n    x: 0\n    x: 1", None,
        "effects.axis_gain[probe].x must be given once; received it in lines 10 and 11"),
    "same section twice": ("effects: {}\neffects: {}", None,
        "effects must be given once; received it in lines 8 and 9"),
    "scatter of no size": ("effects:\n  position_jitter[arm]: {sd_m: 0}", 9,
        "effects.position_jitter[arm].sd_m must be > 0; received 0"),
    "time before the beginning": (
        "effects:\n  coil_heating[coil]: {loss_per_K: 0, loss_per_A2: 0.1, tau_h: -1}", 9,
        "effects.coil_heating[coil].tau_h must be > 0; received -1"),
    "value outside its prior": (
        "effects:\n  range_clipping[probe]: {limit_T: {value: 5, prior: {uniform: {lower: 0, upper: 1}}}}", 9,
        "effects.range_clipping[probe].limit_T must lie within its prior (0 to 1); received 5"),
    "unknown prior": ("effects:\n  axis_gain[probe]: {x: {prior: {gauss: {mean: 0, sd: 1}}}, y: 0, z: 0}", 9,
        "effects.axis_gain[probe].x.prior must be one of normal, log_normal, uniform; received gauss"),
    "tie to another unit": ("effects:\n  axis_gain[probe]: {x: {tied_to: coil.radius_m}, y: 0, z: 0}", 9,
        "effects.axis_gain[probe].x must be tied to a parameter in 1; received coil.radius_m in m"),
}  # fmt: skip


def test_a_neighbour_is_refused_where_there_is_none():
    message = refusal("effects:\n  neighbour_coil[coil]: {share: 0.1}")
    assert message.startswith("effects.neighbour_coil[coil] ")
    assert "none in this rig" in message
    assert message.endswith("received 'coil' (rig.yaml, line 9)")


@pytest.mark.parametrize("key", ["x", "x_uT"])
def test_key_with_a_missing_or_other_unit_is_named_as_it_is_written(key):
    message = refusal(f"effects:\n  background_field[room]: {{{key}: 20, y_T: 0, z_T: 0}}")
    assert f".{key} " in message


@pytest.mark.parametrize(
    "effect",
    [
        "axes_swapped[probe]: {x_reads: 0, y_reads: 7, z_reads: 3}",
        "outliers[probe]: {share: 1.5, ratio: 3}",
        "unit_error[record]: {field_factor: 1, current_factor: 0}",
        "current_sign[coil]: {sign: 2}",
    ],
)
def test_a_value_that_the_cause_cannot_have_is_refused(effect):
    assert "; received " in refusal(f"effects:\n  {effect}")


def test_empty_section_is_a_rig_without_effects():
    assert rig_with("effects: {}").effects == ()


def test_effects_are_kept_in_file_order_with_values_and_priors_in_si():
    rig = rig_with(
        "effects:\n  sensor_offset[probe]: {x_T: 1e-5, y_T: 0, z_T: {prior: {normal: {mean: 0, sd: 5e-5}}}}\n"
        "  current_gain[coil]: {excess: -0.01}"
    )
    assert rig.effects == (Cause("sensor_offset", "probe"), Cause("current_gain", "coil"))
    assert rig.parameters["sensor_offset[probe].x_T"].value == 1e-5
    assert rig.parameters["current_gain[coil].excess"].value == -0.01
    free = rig.parameters["sensor_offset[probe].z_T"]
    assert (free.prior, free.unit, free.value) == (Normal(0.0, 5e-5), "T", 0.0)
    assert [parameter.name for parameter in rig.free] == ["sensor_offset[probe].z_T"]


def test_an_effect_may_be_tied_to_another_number_of_the_rig():
    rig = rig_with(
        "effects:\n  axis_gain[probe]: {x: 0.02, y: {tied_to: 'axis_gain[probe].x', factor: -1}, z: 0}"
    )
    assert rig.nominal_values()["axis_gain[probe].y"] == -0.02


def test_effects_change_the_hash_of_the_rig():
    small, large = (
        rig_with(f"effects:\n  current_gain[coil]: {{excess: {value}}}") for value in (0.01, 0.02)
    )
    assert len({small.hash, large.hash, rig_with("").hash}) == 3


SMALL = rig_with("")


def test_every_cause_can_be_written_at_its_place():
    for name, effect in EFFECTS.items():
        if not (places := effect.places(SMALL)):
            continue
        quantities = {q.key: q.prior.centre if q.is_positive else q.null for q in effect.quantities(Extent())}
        entries = ", ".join(f"{key}: {value!r}" for key, value in quantities.items())
        section = "corrections" if effect.is_correction else "effects"
        rig = rig_with(f"{section}:\n  {name}[{places[0]}]: {{{entries}}}")
        assert getattr(rig, section) == (Cause(name, places[0]),)
        units = {key: rig.parameters[f"{name}[{places[0]}].{key}"].unit for key in quantities}
        assert units == {q.key: q.unit for q in effect.quantities(Extent())}
