"""Several calibrated coils as one magnet: the laws of its field and forces, and currents that make what is wanted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from estimator.calibration.result import Calibration
from estimator.errors import InvalidInput
from estimator.model.bodies import winding_of
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.rig_files.write import rig_text
from estimator.system.system import System

COIL = """
    radius_mm: {prior: {normal: {mean: 51, sd: 1}}}
    wire_radius_mm: 0.98
    axial_loops: 12
    radial_loops: 5"""
TWO_ARMS = f"""
schema_version: 1
name: two arms
movers:
  arm1: {{motion: UR3e, world_from_base: {{x_mm: -415, y_mm: 131, z_mm: -481}}}}
  arm2: {{motion: displacement}}
coils:
  coil1:{COIL}
    carried_by: arm1
    flange_from_coil: {{z_mm: 70}}
  coil2:{COIL}
    carried_by: arm2
    world_from_coil0: {{x_mm: 90, ry_deg: -90}}
sensors: {{hall: {{noise_uT: 20}}}}
"""
FOUR = [("x", 1), ("x", -1), ("y", 1), ("z", -1)]
JOINTS = torch.deg2rad(torch.tensor([0.0, -90.0, -90.0, 0.0, 90.0, 0.0], dtype=torch.float64))


def tensor(value: object) -> Tensor:
    return torch.tensor(value, dtype=torch.float64)


def calibrated(rig: Rig, seed: int = 0, on: list[float] | None = None, n_draws: int = 60) -> Calibration:
    """A calibration whose best values are the rig's, with draws of its priors."""
    rng = np.random.default_rng(seed)
    draws = {p.name: p.prior.sample(rng, n_draws).reshape(2, -1) for p in rig.free if p.prior}
    row = tensor([on or [1.0] * len(rig.coils)])
    observations = Observations.of(row, {}, row.new_zeros(1, 3))
    return Calibration(rig, observations, rig.nominal_values(), draws, np.zeros((2, n_draws // 2)), {})


def fixed_coils(more: str = "", n: int = 4) -> Rig:
    """Coils around the origin that look at it, on three axes."""
    turn = {"x": "ry_deg", "y": "rx_deg", "z": "ry_deg"}
    angle = {("x", 1): -90, ("x", -1): 90, ("y", 1): 90, ("z", -1): 0}
    coils = "".join(
        f"\n  coil{i}:{COIL}\n    world_from_coil: {{{axis}_mm: {80 * side}, {turn[axis]}: {angle[axis, side]}}}"
        for i, (axis, side) in enumerate(FOUR[:n])
    )
    head = "schema_version: 1\nname: four coils\nsensors: {hall: {noise_uT: 20}}\n"
    return rig_from_text(f"{head}coils:{coils}\n{more}")


@pytest.fixture(scope="module")
def points_m() -> Tensor:
    return tensor(np.random.default_rng(0).uniform(-0.02, 0.02, size=(7, 3)))


@pytest.fixture(scope="module")
def arms() -> System:
    """Both coils in the room of one rig, each calibrated with the other off."""
    rig = rig_from_text(TWO_ARMS)
    return System.of(calibrated(rig, 1, [3.0, 0.0]), calibrated(rig, 1, [0.0, 3.0]))


@pytest.fixture(scope="module")
def magnet() -> System:
    return System.of(calibrated(fixed_coils()))


def test_arms_calibrated_one_at_a_time_give_the_field_of_the_whole_rig(arms, points_m):
    both_arms = calibrated(rig_from_text(TWO_ARMS))
    here = arms.at(points_m, {"arm1": JOINTS})
    assert arms.coils == ("coil1", "coil2")
    assert [[c.name for c in part.rig.coils] for part in arms.parts] == [["coil1"], ["coil2"]]
    currents = {"coil1": 2.0, "coil2": -1.5}
    expected = both_arms.field(points_m, currents, {"arm1": JOINTS})
    torch.testing.assert_close(here.field_T(arms.currents(currents)), expected, rtol=2e-6, atol=1e-12)


def test_the_model_of_each_coil_is_that_of_its_own_calibration(points_m):
    rig = rig_from_text(TWO_ARMS)
    first, second = calibrated(rig), calibrated(rig.with_values({"coil2.radius_m": 0.06}))
    motion, on = {"arm1": JOINTS}, {"coil2": 1.0}
    system = System({"coil1": first, "coil2": second})
    field_T = system.at(points_m, motion).field_T(system.currents(on))
    torch.testing.assert_close(field_T, second.field(points_m, on, motion), rtol=2e-6, atol=1e-12)
    assert (field_T - first.field(points_m, on, motion)).norm() > 0.01 * field_T.norm()


def test_fields_add_up_and_follow_the_sign_of_the_currents(magnet, points_m):
    here, currents_A = magnet.at(points_m), tensor([1.0, -2.0, 0.5, 3.0])
    one_by_one = here.field_T(torch.diag(currents_A))
    torch.testing.assert_close(here.field_T(currents_A), one_by_one.sum(0), rtol=1e-12, atol=1e-18)
    torch.testing.assert_close(here.field_T(-currents_A), -here.field_T(currents_A), rtol=0.0, atol=0.0)
    assert not here.field_T(tensor([0.0] * 4)).any()


def test_the_gradient_is_the_slope_of_the_field_symmetric_and_traceless(arms, points_m):
    currents_A, motion, step_m = tensor([1.0, -2.0]), {"arm1": JOINTS}, 1e-5
    gradient = arms.at(points_m, motion).gradient_T_per_m(currents_A)
    columns = []
    for shift in step_m * torch.eye(3).double():
        ahead, behind = (arms.at(points_m + s * shift, motion).field_T(currents_A) for s in (1, -1))
        columns.append((ahead - behind) / (2 * step_m))
    largest = gradient.abs().max().item()
    torch.testing.assert_close(torch.stack(columns, -1), gradient, rtol=0.0, atol=1e-5 * largest)
    torch.testing.assert_close(gradient, gradient.mT, rtol=0.0, atol=1e-9 * largest)
    assert gradient.diagonal(dim1=-2, dim2=-1).sum(-1).abs().max() < 1e-9 * largest


def test_the_force_is_the_slope_of_the_moment_times_the_field(magnet, points_m):
    currents_A, step_m = tensor([1.0, -2.0, 0.5, 3.0]), 1e-5
    moment = tensor(np.random.default_rng(3).normal(size=(7, 3)))
    force_N = magnet.at(points_m).force_N(moment, currents_A)
    for axis in range(3):
        shift = step_m * torch.eye(3).double()[axis]
        energy = [
            (moment * magnet.at(points_m + s * shift).field_T(currents_A)).sum(-1) / (2 * step_m)
            for s in (1, -1)
        ]
        slope = energy[0] - energy[1]
        torch.testing.assert_close(slope, force_N[:, axis], rtol=0.0, atol=1e-5 * force_N.abs().max().item())


def test_two_coils_pull_each_other_with_opposite_forces():
    """Far apart each coil is a dipole in the other's field."""
    rig = fixed_coils(n=2).with_values({"coil1.world_from_coil.x_m": 1.5, "coil1.world_from_coil.y_m": 0.7})
    system = System.of(calibrated(rig))
    values = system.parts[0].best_values()
    forces = []
    for source, target, axis in ((0, 1, [1.0, 0.0, 0.0]), (1, 0, [-1.0, 0.0, 0.0])):
        moment = 2.0 * winding_of(rig, rig.coils[target], values).moment_m2 * tensor(axis)
        place = [values[f"coil{target}.world_from_coil.{key}_m"] for key in "xyz"]
        currents_A = 2.0 * torch.eye(2).double()[source]
        forces.append(system.at(torch.stack(place)[None]).force_N(moment, currents_A)[0])
    assert (forces[0] + forces[1]).norm() < 0.03 * forces[0].norm()


def test_the_actuation_matrix_times_the_currents_is_field_and_gradient(arms, points_m):
    here, currents_A = arms.at(points_m, {"arm1": JOINTS}), tensor([1.5, -0.7])
    matrix = here.actuation()
    assert matrix.shape == (7, 8, 2)
    made = matrix @ currents_A
    torch.testing.assert_close(made[:, :3], here.field_T(currents_A), rtol=1e-10, atol=1e-16)
    gradient = here.gradient_T_per_m(currents_A)
    expected = gradient[:, [0, 0, 0, 1, 1], [0, 1, 2, 1, 2]]
    torch.testing.assert_close(made[:, 3:], expected, rtol=1e-9, atol=1e-14)
    assert torch.equal(here.actuation(has_gradient=False), matrix[:, :3])


def test_currents_that_made_a_field_or_a_force_are_found_again(points_m):
    system = System.of(calibrated(fixed_coils(n=3)))
    here = system.at(points_m)
    true_A = tensor([[1.0, -2.0, 0.5], [0.3, 0.0, -1.0]])
    solved_A = here.currents_for_field(here.field_T(true_A))
    torch.testing.assert_close(solved_A, true_A[:, None].expand(2, 7, 3), rtol=1e-7, atol=1e-9)
    moment = tensor([0.0, 0.5, 1.0])
    solved_A = here.currents_for_force(moment, here.force_N(moment, true_A))
    torch.testing.assert_close(solved_A, true_A[:, None].expand(2, 7, 3), rtol=1e-5, atol=1e-7)


def test_what_is_there_without_current_is_made_up_for(points_m):
    effects = "effects:\n  background_field[room]: {x_T: 40.0e-6, y_T: 0, z_T: -20.0e-6}\n  current_offset[coil1]: {offset_A: 0.02}\n"
    here = System.of(calibrated(fixed_coils(effects))).at(points_m)
    wanted_T = tensor([[1e-3, 0.0, 2e-3]]).expand(7, 3)
    currents_A = here.currents_for_field(wanted_T)
    made_T = torch.stack([here.field_T(row)[i] for i, row in enumerate(currents_A)])
    torch.testing.assert_close(made_T, wanted_T, rtol=1e-9, atol=1e-14)


def test_bounded_currents_stay_within_and_come_closest(magnet, points_m):
    here, wanted_T = magnet.at(points_m), tensor([[3e-3, 0.0, 2e-3]]).expand(7, 3)
    free_A = here.currents_for_field(wanted_T)
    most_A = 0.6 * float(free_A.abs().max())
    bounded_A = here.currents_for_field(wanted_T, most_A)
    assert (bounded_A.abs() <= most_A * (1 + 1e-9)).all()
    matrix = here.actuation(has_gradient=False)

    def missed(currents_A: Tensor) -> Tensor:
        return ((matrix @ currents_A[..., None])[..., 0] - wanted_T).norm(dim=-1)

    assert (missed(bounded_A) <= missed(free_A.clamp(-most_A, most_A)) + 1e-12).all()
    assert (missed(bounded_A) < missed(free_A.clamp(-most_A, most_A)) - 1e-5).any()


def test_one_stand_for_each_point_equals_stand_by_stand_and_carries_the_derivative_of_the_joints(
    arms, points_m
):
    joints = JOINTS + 0.05 * tensor(np.random.default_rng(1).normal(size=(7, 6)))
    currents_A = tensor([2.0, 1.0])
    together = arms.at(points_m, {"arm1": joints}).field_T(currents_A)
    for i in range(7):
        alone = arms.at(points_m[i : i + 1], {"arm1": joints[i]}).field_T(currents_A)
        torch.testing.assert_close(together[i : i + 1], alone, rtol=3e-6, atol=1e-12)

    moved = joints.clone().requires_grad_()
    slope = torch.autograd.grad(arms.at(points_m, {"arm1": moved}).field_T(currents_A)[:, 0].sum(), moved)[0]
    step = torch.zeros_like(joints)
    step[:, 1] = 1e-5
    ahead, behind = (
        arms.at(points_m, {"arm1": joints + s * step}).field_T(currents_A)[:, 0] for s in (1, -1)
    )
    torch.testing.assert_close(slope[:, 1], (ahead - behind) / 2e-5, rtol=1e-4, atol=1e-8)


def test_currents_are_differentiable_in_the_place_and_the_target(magnet, points_m):
    def currents_A(points: Tensor, wanted_T: Tensor) -> Tensor:
        return magnet.at(points).currents_for_field(wanted_T)

    wanted_T = tensor([[1e-3, 0.0, 2e-3]]).repeat(7, 1)
    slopes = torch.autograd.functional.jacobian(currents_A, (points_m, wanted_T))
    step_m = 1e-5 * torch.eye(3).double()[1]
    ahead, behind = (currents_A(points_m + s * step_m, wanted_T) for s in (1, -1))
    along = torch.stack([slopes[0][i, :, i, 1] for i in range(7)])
    torch.testing.assert_close(along, (ahead - behind) / 2e-5, rtol=1e-3, atol=1e-3)
    assert torch.isfinite(slopes[1]).all()


def test_intervals_hold_the_field_of_the_draws_and_separate_calibrations_err_independently(points_m):
    """Two calibrations with the same seed have the same draws; the variance of their sum is still that of independent ones."""
    rig = rig_from_text(TWO_ARMS)
    first, second = (calibrated(rig, 5, on, n_draws=400) for on in ([1.0, 0.0], [0.0, 1.0]))
    same = dict.fromkeys(first.draws, first.draws["coil1.radius_m"])
    first, second = replace(first, draws=same), replace(second, draws=same)
    system, motion = System.of(first, second), {"arm1": JOINTS}
    here = system.at(points_m, motion)
    widths = []
    for currents in ({"coil1": 3.0}, {"coil2": 3.0}, {"coil1": 3.0, "coil2": 3.0}):
        lower, upper = here.field_interval_T(system.currents(currents), 0.68)
        field_T = here.field_T(system.currents(currents))
        assert ((lower < field_T) & (field_T < upper))[field_T.abs() > 1e-5].all()
        widths.append(upper - lower)
    big = (widths[0] > 1e-6) & (widths[1] > 1e-6)
    assert (widths[2] / torch.hypot(widths[0], widths[1]))[big].median().item() == pytest.approx(
        1.0, abs=0.15
    )
    lower, _ = first.field_interval(points_m, {"coil1": 3.0}, 0.68, motion)
    torch.testing.assert_close(
        here.field_interval_T(system.currents({"coil1": 3.0}), 0.68)[0], lower, rtol=1e-4, atol=1e-9
    )
    batch = here.field_interval_T(torch.stack([system.currents({"coil1": 3.0})] * 2))[0]
    assert batch.shape == (2, 7, 3)
    low, high = here.gradient_interval_T_per_m(system.currents({"coil1": 3.0}))
    gradient = here.gradient_T_per_m(system.currents({"coil1": 3.0}))
    assert ((low < gradient) & (gradient < high))[gradient.abs() > 1e-3].all()


def test_a_field_of_the_room_counts_once(points_m):
    rig = rig_from_text(
        TWO_ARMS + "effects:\n  background_field[room]: {x_T: 40.0e-6, y_T: 0, z_T: -20.0e-6}\n"
    )
    system = System.of(calibrated(rig, on=[1.0, 0.0]), calibrated(rig, on=[0.0, 1.0]))
    field_T = system.at(points_m, {"arm1": JOINTS}).field_T(tensor([0.0, 0.0]))
    torch.testing.assert_close(field_T, tensor([4e-5, 0.0, -2e-5]).expand(7, 3))


def test_a_correction_goes_with_its_coil_and_one_of_the_room_counts_once(points_m):
    middle = "middle_x_m: 0, middle_y_m: 0, middle_z_m: 0, reach_m: 0.1"
    corrections = f"""
corrections:
  coil_harmonics[coil0]: {{{middle}, degree1_cos0_T_per_A: 1.0e-4, degree1_cos1_T_per_A: 0, degree1_sin1_T_per_A: 0}}
  room_harmonics[room]: {{{middle}, degree1_cos0_T: 0, degree1_cos1_T: 3.0e-4, degree1_sin1_T: 0}}
"""
    text = rig_text(fixed_coils(n=2))
    rigs = [rig_from_text(text + more) for more in ("", corrections)]
    corrected, plain = (
        System.of(*(calibrated(rig, on=on) for on in ([1.0, 0.0], [0.0, 1.0]))) for rig in reversed(rigs)
    )
    added_T = [
        system.at(points_m).field_T(system.currents({"coil0": 2.0, "coil1": 1.0}))
        for system in (corrected, plain)
    ]
    by_room_T, by_coil_T = 3.0e-4, 2.0e-4
    norm_T = (added_T[0] - added_T[1]).norm(dim=-1)
    assert float(norm_T.min()) > by_room_T - by_coil_T - 1e-12
    assert float(norm_T.max()) < by_room_T + by_coil_T + 1e-12
    alone_T = corrected.at(points_m).field_T(corrected.currents({})) - plain.at(points_m).field_T(
        plain.currents({})
    )
    torch.testing.assert_close(alone_T[..., 0], torch.full_like(alone_T[..., 0], by_room_T))


def test_inside_a_winding_nothing_is_known(magnet, points_m):
    inside = torch.cat((points_m[:2], tensor([[0.085, 0.045, 0.0]])))
    here, on = magnet.at(inside), tensor([1.0, 0.0, 0.0, 0.0])
    for result in (
        here.field_T(on),
        here.actuation(),
        here.force_N(tensor([0.0, 0.0, 1.0]), on),
        here.currents_for_field(torch.full((3, 3), 1e-3).double()),
        here.currents_for_field(torch.full((3, 3), 1e-3).double(), 0.1),
    ):
        assert torch.isnan(result[2]).all()
        assert torch.isfinite(result[:2]).all()


def test_coils_on_in_two_calibrations_or_in_none_are_refused():
    rig = rig_from_text(TWO_ARMS)
    with pytest.raises(InvalidInput, match="coil1 must be on in one calibration; received two"):
        System.of(calibrated(rig, on=[1.0, 0.0]), calibrated(rig))
    with pytest.raises(InvalidInput, match="at least one coil"):
        System.of(
            replace(calibrated(rig, on=[1.0, 0.0]), observations=calibrated(rig, on=[0.0, 0.0]).observations)
        )
    with pytest.raises(InvalidInput, match=r"has coil1, coil2, not 'coil3'"):
        System({"coil3": calibrated(rig)})


def test_unknown_names_and_stands_that_are_not_said_are_refused(arms, points_m):
    with pytest.raises(InvalidInput, match=r"coils of the system \(coil1, coil2\); received 'coil9'"):
        arms.currents({"coil9": 1.0})
    with pytest.raises(InvalidInput, match=r"movers of the system \(arm1, arm2\); received 'leg'"):
        arms.at(points_m, {"arm1": JOINTS, "leg": JOINTS})
    with pytest.raises(InvalidInput, match="motion of arm1 must be given"):
        arms.at(points_m)
    with pytest.raises(InvalidInput, match="six for each of 7 points"):
        arms.at(points_m, {"arm1": JOINTS.expand(3, 6)})
    with pytest.raises(InvalidInput, match="level must lie between 0 and 1"):
        arms.at(points_m, {"arm1": JOINTS}).field_interval_T(tensor([1.0, 1.0]), 90.0)


def test_a_core_that_saturates_has_a_field_but_no_actuation_matrix(points_m):
    effects = "effects:\n  core_saturation[coil1]: {share: 0.5, loss_per_A2: 0.01}\n"
    here = System.of(calibrated(fixed_coils(effects))).at(points_m)
    assert torch.isfinite(here.field_T(tensor([0.0, 1.0, 0.0, 0.0]))).all()
    with pytest.raises(InvalidInput, match=r"core_saturation\[coil1\]"):
        here.actuation()
