"""What a session can reveal: the numbers of docs/explanation/what-cannot-be-told-apart.md, what is absorbed, which causes are twins, and what a size means.

The sizes are those of a grid of 5^3 positions whose middle lies 35 mm in front of the coil, visited to and fro at 3 A with 20 uT of noise:
all of them then come out within a quarter. configs/paper_simulation.yaml puts the middle at 40 mm, where gradients
are weaker (mount_tilt 2.2 instead of 1.4 mrad), and visits row by row from the same side, which hides lag and backlash.
"""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.candidates import candidates
from estimator.diagnosis.next_readings.resolution import (
    MUCH_ABSORBED,
    _basis,
    indistinguishable,
    smallest_visible,
)
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.read import rig_from_text
from tests.estimator.diagnosis.paper_grid import (
    Resolved,
    at,
    columns_of,
    paper_rig,
    resolved,
    visit,
)

pytestmark = pytest.mark.whole

# Cause: unit of the numbers, smallest and largest of its quantities in docs/explanation/what-cannot-be-told-apart.md.
SIZES = {
    "background_field": (1e-6, 12.0, 21.0),
    "axis_gain": (1e-2, 0.2, 0.2),
    "cross_axis": (1e-2, 0.24, 0.24),
    "element_displacement": (1e-6, 50.0, 100.0),
    "robot_scale": (1e-2, 0.13, 0.22),
    "mount_tilt": (1e-3, 1.2, 1.2),
    "position_lag": (1e-6, 25.0, 25.0),
}
OTHERS = ("sensor_offset", "offset_drift", "background_drift", "backlash", "coil_heating")
ORDERS = ("snake", "raster", "random")


@pytest.fixture(scope="module")
def near() -> dict[str, Resolved]:
    """The grid at 35 mm in every order."""
    rig = paper_rig()
    names = (*SIZES, *OTHERS)
    return {order: resolved(rig, visit(rig, 35.0, order), names, 35.0) for order in ORDERS}


@pytest.fixture(scope="module")
def configured() -> Resolved:
    """The grid as configs/paper_simulation.yaml has it, with the causes that docs/explanation/what-cannot-be-told-apart.md calls absorbed or twins."""
    rig = paper_rig()
    absorbed = (
        "current_gain",
        "current_offset",
        "axial_pitch",
        "radial_pitch",
        "iron_core",
        "core_saturation",
    )
    return resolved(rig, visit(rig, 40.0, "raster"), (*SIZES, *OTHERS, *absorbed), 40.0)


def twins(result: Resolved) -> list[set[str]]:
    return [{cause.name for cause in group} for group in indistinguishable(result.fit, result.pool)]


@pytest.mark.parametrize("name", SIZES)
def test_five_sigma_sizes_are_those_of_the_documentation(near, name):
    unit, low, high = SIZES[name]
    sizes = [size / unit for size in near["snake"].sizes(name).values()]
    assert 0.75 * low < min(sizes)
    assert max(sizes) < 1.25 * high


@pytest.mark.parametrize("order", ORDERS)
def test_drift_over_the_session_shows_from_19_to_27_microtesla(near, order):
    result = near[order]
    hours = result.fit.posterior.model.circumstances.duration_h
    sizes = [1e6 * hours * size for size in result.sizes("offset_drift").values()]
    assert 0.9 * 19.0 < min(sizes) <= max(sizes) < 1.1 * 27.0


@pytest.mark.parametrize(("order", "percent"), [("raster", 0.8), ("random", 0.4)])
def test_heating_shows_sooner_in_random_order(near, order, percent):
    """The loss of a coil in thermal equilibrium at 3 A."""
    loss = near[order].sizes("coil_heating")["loss_per_A2"] * 3.0**2
    assert 100.0 * loss == pytest.approx(percent, rel=0.25)


def test_lag_and_play_hide_where_every_row_is_begun_from_the_same_side(near):
    lag = {order: near[order].sizes("position_lag")["lag_m"] for order in ORDERS}
    assert lag["snake"] < lag["random"] < 0.5 * lag["raster"]
    play = {order: near[order].sizes("backlash")["z_m"] for order in ORDERS}
    assert max(play["snake"], play["random"]) < 0.5 * play["raster"]
    assert 0.5 * play["snake"] == pytest.approx(25e-6, rel=0.35)  # half the play is what the axis misses


@pytest.mark.parametrize("name", [name for name in SIZES if name != "position_lag"])
def test_five_millimetres_farther_off_everything_shows_less_but_for_fields_of_the_room(
    near, configured, name
):
    for key, size in configured.sizes(name).items():
        ratio = size / near["raster"].sizes(name)[key]
        assert (0.9 if name == "background_field" else 1.1) < ratio < 1.7


@pytest.mark.parametrize("name", ["current_gain", "current_offset", "axial_pitch", "radial_pitch"])
def test_what_the_free_parameters_follow_does_not_show(configured, name):
    """Beyond three widths of its prior, so that a plausible size cannot be seen."""
    for v in configured.pool:
        if v.cause.name == name:
            assert all(
                configured.sizes(name)[key] > 3.0 * float(sd)
                for key, sd in zip(v.keys, v.prior_sd, strict=True)
            )
    assert not any(name in group for group in twins(configured))


def test_isotropic_robot_scale_is_followed_by_the_size_of_the_coil(configured):
    """All lengths times k give the field over k (Biot and Savart); one axis alone is no such scaling."""
    candidate = next(c for c in configured.pool if c.cause.name == "robot_scale")
    own = configured.fit.projector.rest(candidate.columns)
    all_axes, one_axis = 5.0 / float(own.sum(1).norm()), 5.0 / float(own[:, 0].norm())
    assert one_axis < 0.003
    assert all_axes > 30.0 * one_axis


def test_ratio_of_pitches_shows_once_counts_are_known_but_not_by_the_wire_radius_alone():
    """A field tells turns, length and thickness. With the wire known there remain N_a, N_r and a pitch, which follow all three; what
    is left are the priors of the counts. Whole counts tell the ratio by the wire too; this linear view lets them run.
    """
    sizes = {}
    for known in (("coil1.axial_loops", "coil1.radial_loops"), ("coil1.wire_radius_m",)):
        rig = paper_rig(("hall.noise_T", *known))
        result = resolved(rig, visit(rig, 40.0, "raster"), ("axial_pitch", "radial_pitch"), 40.0)
        sizes[known[0]] = [result.sizes(name)["excess"] for name in ("axial_pitch", "radial_pitch")]
    assert max(sizes["coil1.axial_loops"]) < 0.06
    assert min(sizes["coil1.wire_radius_m"]) > 0.15


def test_reversed_current_lets_an_offset_of_the_current_show(configured):
    rig = paper_rig()
    both = resolved(rig, visit(rig, 40.0, "raster", currents_A=(3.0, -3.0)), ("current_offset",), 40.0)
    size = both.sizes("current_offset")["offset_A"]
    assert size < 0.01
    assert configured.sizes("current_offset")["offset_A"] > 50.0 * size


def test_fixed_sensor_cannot_tell_the_room_from_its_own_zero(configured):
    groups = twins(configured)
    assert {"background_field", "sensor_offset"} in groups
    assert {"background_drift", "offset_drift"} in groups
    for room, own in (("background_field", "sensor_offset"), ("background_drift", "offset_drift")):
        assert configured.sizes(room) == pytest.approx(configured.sizes(own), rel=1e-6)


MAPPER = """
schema_version: 1
name: mapper
movers: {mapper: {motion: pose}}
coils:
  coil: {radius_mm: {prior: {normal: {mean: 40, sd: 1}}}, wire_radius_mm: 0.5, axial_loops: 20, radial_loops: 10}
sensors:
  probe: {carried_by: mapper, noise_uT: 20}
"""


def scattered(rig: Rig, is_turned: bool = False) -> Fit:
    """Fit of the mapper to what it would read at 40 places, where every second one may have the probe turned."""
    n = 40
    motion = torch.zeros(n, 6, dtype=torch.float64)
    motion[:, :3] = 0.03 * torch.randn(n, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    motion[:, 2] = motion[:, 2].abs() + 0.02
    motion[::2, 3] = 0.5 * math.pi if is_turned else 0.0
    empty = Observations.of(torch.full((n, 1), 3.0).double(), {"mapper": motion}, torch.zeros(n, 3).double())
    model = MeasurementModel.build(rig, empty)
    nominal = {name: torch.tensor(v, dtype=torch.float64) for name, v in rig.nominal_values().items()}
    readings = empty.with_field(model.predict(nominal))
    return fit_rig(rig, readings, {}, model.rules)


@pytest.mark.parametrize("is_turned", [False, True])
def test_second_orientation_of_the_sensor_tells_the_room_from_its_own_zero(is_turned):
    fit = scattered(rig_from_text(MAPPER), is_turned)
    pool = candidates(fit, [Cause("background_field", "room"), Cause("sensor_offset", "probe")])
    assert bool(indistinguishable(fit, pool)) is not is_turned


def test_a_free_pose_is_not_made_wrong_by_what_is_another_word_for_it():
    """Its prior holds some of that back, but the base then is where the fit says. A skewed axis does make the pose wrong."""
    free = "world_from_base: {x_mm: {prior: {normal: {mean: 0, sd: 3}}}}"
    rig = rig_from_text(MAPPER.replace("motion: pose", f"motion: pose, {free}").replace("uT: 20", "uT: 100"))
    fit = scattered(rig)
    pool = candidates(fit, [Cause("base_misplaced", "mapper"), Cause("robot_shear", "mapper")])
    visible = {(v.cause.name, v.key): v for v in smallest_visible(fit, pool)}
    assert 0.9 < visible["base_misplaced", "x_m"].share_absorbed < 0.998
    assert visible["base_misplaced", "x_m"].hidden_sd == 0.0
    assert visible["base_misplaced", "z_m"].hidden_sd > 0.0  # of which the rig has no number
    assert visible["robot_shear", "xz"].hidden_sd > 0.0


@pytest.mark.parametrize(("currents_A", "is_twin"), [((3.0,), True), ((3.0, 1.0), False)])
def test_saturation_of_a_core_needs_a_second_magnitude_of_the_current(currents_A, is_twin):
    rig = paper_rig()
    result = resolved(
        rig, visit(rig, 40.0, "raster", currents_A=currents_A), ("iron_core", "core_saturation"), 40.0
    )
    assert ({"iron_core", "core_saturation"} in twins(result)) is is_twin


def test_displaced_element_is_nearly_a_cross_sensitivity(near):
    """The field has no curl: the z element moved along x sees d Bx / dz, much like Bx itself. Close, but no twins."""
    result = near["snake"]
    moved = columns_of(result, Cause("element_displacement", "hall"), "z_at_x_m")
    mixed = columns_of(result, Cause("cross_axis", "hall"), "zx")
    left = result.fit.projector.rest(torch.stack((moved, mixed), dim=1))
    cosine = float(torch.nn.functional.cosine_similarity(left[:, 0], left[:, 1], dim=0))
    assert abs(cosine) == pytest.approx(0.94, abs=0.01)
    assert not any({"element_displacement", "cross_axis"} <= group for group in twins(result))


@pytest.mark.parametrize("repeats", [4, 9])
def test_smallest_visible_size_falls_with_the_square_root_of_the_readings(configured, repeats):
    rig = paper_rig()
    names = ("background_field", "axis_gain", "element_displacement", "robot_scale", "mount_tilt")
    repeated = resolved(rig, visit(rig, 40.0, "raster", repeats=repeats), names, 40.0)
    for name in names:
        for key, size in repeated.sizes(name).items():
            assert configured.sizes(name)[key] / size == pytest.approx(math.sqrt(repeats), rel=0.05)


def test_size_of_an_offset_that_nothing_follows_is_five_standard_errors_of_the_mean():
    """Where only the radius is free, symmetry keeps it from following a transverse field."""
    rig = paper_rig()
    alone = paper_rig(
        p.name for p in rig.parameters.values() if p.prior is not None or p.name == "hall.noise_T"
    )
    free = replace(rig.parameters["coil1.radius_m"])
    alone = replace(alone, parameters={**alone.parameters, "coil1.radius_m": free}).with_values(
        {f"coil1.world_from_coil0.{key}": 0.0 for key in ("x_m", "y_m", "tilt_x_rad", "tilt_y_rad")}
    )
    centred = {name: p.value for name, p in alone.parameters.items() if p.tie is None}
    observations = visit(alone, 40.0, "raster")
    rules = MeasurementModel.build(alone, observations).rules
    fit = fit_rig(alone, observations, centred, rules)
    result = Resolved(fit, candidates(fit, [Cause("sensor_offset", "hall")]))
    assert result.sizes("sensor_offset")["x_T"] == pytest.approx(5.0 * 20e-6 / math.sqrt(125), rel=1e-3)


@pytest.mark.parametrize(
    ("cause", "key"),
    [
        (Cause("axis_gain", "hall"), "x"),
        (Cause("background_field", "room"), "z_T"),
        (Cause("robot_scale", "arm1"), "z"),
        (Cause("mount_tilt", "coil1"), "y_rad"),
        (Cause("element_displacement", "hall"), "z_at_x_m"),
    ],
)
def test_cause_of_the_smallest_visible_size_costs_the_fit_five_sigma(configured, cause, key):
    """Noise-free readings with the cause, fitted without it: squared residuals and prior penalties add up to 25."""
    fit, size = configured.fit, configured.sizes(cause.name)[key]
    wrong = with_effect(fit.rig, cause, fit.observations, {}, is_free=False).with_values(
        {**at(fit.rig, 40.0), f"{cause.label}.{key}": size}
    )
    model = MeasurementModel.unruled(wrong, fit.observations).with_rules(fit.posterior.model.rules)
    values = {name: torch.tensor(v, dtype=torch.float64) for name, v in wrong.nominal_values().items()}
    perfect = fit.observations.with_field(model.predict(values).detach().expand(len(fit.observations), 3))
    right = fit.observations.with_field(
        fit.posterior.model.predict({n: values[n] for n in fit.values}).detach()
    )
    cost = [
        fit_rig(fit.rig, readings, at(fit.rig, 40.0), fit.posterior.model.rules).optimum.log_posterior[0]
        for readings in (right, perfect)
    ]
    assert 2.0 * float(cost[0] - cost[1]) == pytest.approx(25.0, rel=0.15)


@pytest.mark.parametrize(
    ("cause", "key", "share"),
    [
        (Cause("current_gain", "coil1"), "excess", 1.0),
        (Cause("axis_gain", "hall"), "x", 0.0),
        (Cause("background_field", "room"), "z_T", 0.0),
    ],
)
def test_what_a_cause_hides_in_is_where_a_fit_without_it_goes(cause, key, share):
    """At the largest size that stays unseen, of noise-free readings; and its place is told."""
    rig = paper_rig()
    result = resolved(rig, visit(rig, 40.0, "raster"), (cause.name,), 40.0)
    fit = result.fit
    visible = next(v for v in smallest_visible(fit, result.pool) if (v.cause, v.key) == (cause, key))
    assert visible.share_absorbed == pytest.approx(share, abs=0.9 if share == 0.0 else 0.05)
    assert bool(visible.absorbed_by) is (visible.share_absorbed > MUCH_ABSORBED)
    null = EFFECTS[cause.name].quantities(fit.posterior.model.circumstances.extent)
    null = next(quantity.null for quantity in null if quantity.key == key)
    wrong = with_effect(fit.rig, cause, fit.observations, {}, is_free=False).with_values(
        {**at(fit.rig, 40.0), f"{cause.label}.{key}": null + visible.hidden_size}
    )
    model = MeasurementModel.unruled(wrong, fit.observations).with_rules(fit.posterior.model.rules)
    values = {name: torch.tensor(v, dtype=torch.float64) for name, v in wrong.nominal_values().items()}
    flawed = fit.observations.with_field(model.predict(values).detach().expand(len(fit.observations), 3))
    right = fit.observations.with_field(
        fit.posterior.model.predict({n: values[n] for n in fit.values}).detach()
    )
    there, here = (
        fit_rig(fit.rig, readings, at(fit.rig, 40.0), fit.posterior.model.rules)
        for readings in (flawed, right)
    )
    names = fit.posterior.coordinates.quantities
    sd = fit.covariance.diagonal().sqrt()
    moved = dict(zip(names, ((there.vector - here.vector) / sd).abs().tolist(), strict=True))
    assert moved[visible.hidden_in] == pytest.approx(visible.hidden_sd, rel=0.25, abs=0.1)
    there_here = (fit.posterior.coordinates.values(each.vector) for each in (there, here))
    turns = [float(at["coil1.axial_loops"] * at["coil1.radial_loops"]) for at in there_here]
    if visible.hidden_in == "coil1.turns":
        assert turns[0] - turns[1] == pytest.approx(visible.hidden_shift, rel=0.25)
    told = {name: far for name, far in moved.items() if not name.endswith(".noise_T")}
    assert max(told.values()) == pytest.approx(moved[visible.hidden_in], rel=0.25, abs=0.1)


@pytest.mark.parametrize(("n_columns", "n_independent"), [(7, 7), (60, 12), (240, 60)])
def test_independent_directions_are_as_many_as_columns_were_made_of(n_columns, n_independent):
    generator = torch.Generator().manual_seed(n_columns)
    of_each = torch.randn(300, n_independent, generator=generator, dtype=torch.float64)
    mixed = torch.randn(n_independent, n_columns, generator=generator, dtype=torch.float64)
    basis = _basis(of_each @ mixed)
    assert basis.shape[1] == n_independent
    assert torch.allclose(basis.T @ basis, torch.eye(n_independent, dtype=torch.float64))


def test_a_cause_of_many_directions_still_finds_its_twin(near):
    result = near["random"]
    wide = max(result.pool, key=lambda candidate: candidate.columns.shape[1])
    twin = [replace(c, cause=Cause("unheard_of", "room")) for c in result.pool if c.cause == wide.cause]
    others = [c for c in result.pool if len(c.keys) < len(wide.keys)]
    groups = indistinguishable(
        result.fit, [*others, *twin, *(c for c in result.pool if c.cause == wide.cause)]
    )
    assert any({cause.name for cause in group} == {"unheard_of", wide.cause.name} for group in groups)
