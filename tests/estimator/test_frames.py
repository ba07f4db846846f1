from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.func import hessian, jacfwd, jacrev, vmap

from estimator.derivatives import jacobian_of
from estimator.frames import Transform
from estimator.rotations import (
    first_derivatives_only,
    rotation_from_vector,
    turned,
    vector_from_rotation,
)

# Skew matrices of x, y, z: the derivatives of a rotation matrix at zero rotation, last axis the component.
GENERATORS = torch.tensor(
    [
        [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
        [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]],
        [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
    ],
    dtype=torch.float64,
)
# Both sides of every switch between series and closed form (angle and half angle 0.0316), and the ends.
ANGLES_RAD = (0.0, 1e-300, 1e-9, 1e-3, 0.03162, 0.03163, 0.0632, 0.0633, 0.5, 1.5, 3.0, 3.1415, torch.pi)


def tensor(values: object) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def random_vectors(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def random_transform(*shape: int, seed: int = 0) -> Transform:
    return Transform.from_pose(random_vectors(*shape, seed=seed), random_vectors(*shape, seed=seed + 100))


def homogeneous(transform: Transform) -> Tensor:
    top = torch.cat([transform.rotation, transform.translation_m[..., None]], -1)
    return torch.cat([top, tensor([[0, 0, 0, 1]]).expand(*top.shape[:-2], 1, 4)], -2)


def vectors(longest: float) -> st.SearchStrategy[Tensor]:
    """Rotation vectors of all directions, with many short ones."""
    component = st.floats(-1, 1)
    length = st.one_of(st.floats(0, longest), st.floats(0, 1e-2).map(lambda x: min(x, longest) ** 3))
    direction = st.tuples(component, component, component).map(tensor).filter(lambda v: v.norm() > 1e-3)
    return st.builds(lambda v, angle_rad: v / v.norm() * angle_rad, direction, length)


@given(vectors(longest=20.0))
def test_rotation_from_vector_agrees_with_scipy_at_any_angle(vector: Tensor) -> None:
    expected = Rotation.from_rotvec(vector.numpy()).as_matrix()
    torch.testing.assert_close(rotation_from_vector(vector), tensor(expected), rtol=0, atol=5e-15)


@pytest.mark.parametrize("angle_rad", ANGLES_RAD)
def test_rotation_and_its_derivatives_agree_with_the_matrix_exponential(angle_rad):
    vector = tensor([2.0, -6.0, 3.0]) / 7 * angle_rad

    def exponential(v: Tensor) -> Tensor:  # Its power series: torch.linalg.matrix_exp is good to 1e-11 only.
        skew = torch.einsum("i,ijk->jk", v, GENERATORS)
        total = term = torch.eye(3, dtype=torch.float64)
        for power in range(1, 40):
            term = term @ skew / power
            total = total + term
        return total

    for derivative in (lambda f: f, jacfwd, jacrev, hessian):
        torch.testing.assert_close(
            derivative(rotation_from_vector)(vector), derivative(exponential)(vector), rtol=0, atol=1e-13
        )


@pytest.mark.parametrize("angle_rad", ANGLES_RAD)
def test_where_first_derivatives_are_enough_they_and_the_values_are_the_same(angle_rad):
    direction = random_vectors(2, seed=5)
    some = angle_rad * direction / direction.norm(dim=-1, keepdim=True)

    def rotations(vectors: Tensor) -> Tensor:
        return rotation_from_vector(vectors.unflatten(0, (2, 3)))

    with first_derivatives_only():
        free = some.flatten().requires_grad_()
        value, jacobian = rotations(free).detach(), jacobian_of(rotations, free)
    torch.testing.assert_close(value, rotation_from_vector(some.detach()), rtol=0.0, atol=1e-15)
    torch.testing.assert_close(jacobian, jacfwd(rotations)(free.detach()), rtol=0.0, atol=2e-14)
    with first_derivatives_only(is_enough=False):
        twice = torch.func.hessian(lambda v: rotations(v).sum())(free.detach())
    assert twice.abs().max() > 0.0


@pytest.mark.parametrize("angle_rad", ANGLES_RAD[:-1])
@pytest.mark.parametrize("derivative", [jacfwd, jacrev])
def test_vector_from_rotation_undoes_small_and_large_rotations_and_their_derivatives(derivative, angle_rad):
    for direction in (tensor([2.0, -6.0, 3.0]) / 7, tensor([-1.0, 0.0, 0.0]), tensor([0.0, 0.0, 1.0])):

        def there_and_back(v: Tensor) -> Tensor:
            return vector_from_rotation(rotation_from_vector(v))

        vector = direction * angle_rad
        torch.testing.assert_close(there_and_back(vector), vector, rtol=3e-15, atol=0)
        identity = torch.eye(3, dtype=torch.float64)
        torch.testing.assert_close(derivative(there_and_back)(vector), identity, rtol=0, atol=1e-12)


@given(vectors(longest=3.14159265))
def test_vector_from_rotation_undoes_rotation_from_vector(vector: Tensor) -> None:
    torch.testing.assert_close(vector_from_rotation(rotation_from_vector(vector)), vector, rtol=0, atol=1e-14)


@pytest.mark.parametrize("excess_rad", [0.0, 1e-12, -1e-12, 1e-8, -1e-8, 1e-4, -1e-4])
@pytest.mark.parametrize(
    "direction", [(1, 0, 0), (0, -1, 0), (0, 0, 1), (1, 1, 0), (-1, 1, 1), (1e-9, 1, 0), (0.3, -0.2, 0.9)]
)
def test_vector_from_rotation_keeps_full_accuracy_around_a_half_turn(direction, excess_rad):
    axis = tensor(direction) / tensor(direction).norm()
    rotation = rotation_from_vector(axis * (torch.pi + excess_rad))
    vector = vector_from_rotation(rotation)
    assert vector.norm().item() <= torch.pi + 1e-15
    torch.testing.assert_close(rotation_from_vector(vector), rotation, rtol=0, atol=5e-15)


def test_chaining_inverting_and_applying_agree_with_homogeneous_matrices_over_broadcast_batches():
    world_from_flange, flange_from_coil = random_transform(4, 1, seed=1), random_transform(3, seed=2)
    world_from_coil = world_from_flange @ flange_from_coil
    expected = homogeneous(world_from_flange) @ homogeneous(flange_from_coil)
    torch.testing.assert_close(homogeneous(world_from_coil), expected)
    torch.testing.assert_close(homogeneous(world_from_coil.inverse()), torch.linalg.inv(expected))

    points_m = random_vectors(5, 1, 3, seed=3)
    ones = torch.ones(5, 4, 3, 1, dtype=torch.float64)
    padded = torch.cat([points_m.expand(5, 4, 3, 3), ones], -1)
    torch.testing.assert_close(world_from_coil.apply(points_m), (expected @ padded[..., None])[..., :3, 0])


def test_from_pose_places_the_origin_and_broadcasts_one_orientation_over_many_positions():
    positions_m, vector = random_vectors(5, seed=1), random_vectors(seed=2)
    transforms = Transform.from_pose(positions_m, vector)
    assert transforms.rotation.shape == (5, 3, 3)
    torch.testing.assert_close(transforms.apply(torch.zeros(3).double()), positions_m)
    torch.testing.assert_close(transforms.rotation[3], rotation_from_vector(vector))
    one_position = Transform.from_pose(positions_m[0], random_vectors(5, seed=3))
    assert one_position.translation_m.shape == (5, 3)


@pytest.mark.parametrize("vector_shape", [(3,), (4, 3), (5, 4, 3), (5, 1, 3), (1, 3)])
@pytest.mark.parametrize("rotation_shape", [(3,), (1, 3), (4, 3), (5, 1, 3), (5, 4, 3)])
def test_vectors_turn_as_by_their_own_rotation_whatever_is_shared(rotation_shape, vector_shape):
    vector_rad, vectors = (
        torch.randn(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
        for seed, shape in enumerate((rotation_shape, vector_shape))
    )
    rotation = rotation_from_vector(vector_rad)
    expected = torch.einsum("...ij,...j->...i", rotation, vectors)
    torch.testing.assert_close(turned(rotation, vectors), expected, rtol=1e-13, atol=1e-14)
    assert turned(rotation, vectors).shape == expected.shape


def test_rotate_ignores_the_translation_and_unrotate_undoes_it():
    world_from_coil, field_coil_T = random_transform(2), random_vectors(7, 2, seed=3)
    field_world_T = world_from_coil.rotate(field_coil_T)
    origin_m = world_from_coil.translation_m
    torch.testing.assert_close(field_world_T, world_from_coil.apply(field_coil_T) - origin_m)
    torch.testing.assert_close(world_from_coil.unrotate(field_world_T), field_coil_T)


def test_single_precision_stays_single_precision():
    pose = Transform.from_pose(random_vectors(2).float(), 1e-3 * random_vectors(2, seed=1).float())
    chain = Transform.identity(torch.float32) @ pose @ pose.inverse()
    vector = vector_from_rotation(pose.rotation)
    for values in (chain.rotation, chain.translation_m, chain.apply(torch.ones(3)), vector):
        assert values.dtype == torch.float32
    torch.testing.assert_close(vector, 1e-3 * random_vectors(2, seed=1).float(), rtol=0, atol=2e-7)


def test_vmap_over_poses_including_zero_rotation_equals_the_batched_call_and_its_derivative():
    poses = torch.cat([random_vectors(6), random_vectors(6, seed=1)], -1)
    poses[2, 3:] = 0.0
    point_m = tensor([0.1, -0.2, 0.3])

    def sensor_in_coil(pose: Tensor) -> Tensor:
        return Transform.from_pose(pose[..., :3], pose[..., 3:]).inverse().apply(point_m)

    def orientation(pose: Tensor) -> Tensor:
        return vector_from_rotation(rotation_from_vector(pose[..., 3:]))

    for function in (sensor_in_coil, orientation):
        torch.testing.assert_close(vmap(function)(poses), function(poses))
        forward, reverse = vmap(jacfwd(function))(poses), vmap(jacrev(function))(poses)
        assert forward.isfinite().all()
        torch.testing.assert_close(forward, reverse)


def test_relative_displacement_formula_equals_the_chain_of_frames():
    """Paper, equations 18 to 22, corrected: p = -flange_from_coil.R^T dt - world_from_coil0.R^T t.

    dt is the displacement in the flange frame of the reference pose, t the position of the coil there, p that
    of the sensor in the coil; the sensor is the origin of the world.
    """
    world_from_coil0, flange_from_coil = random_transform(seed=1), random_transform(seed=2)
    dt_flange_m = random_vectors(20, seed=3)
    world_from_flange0 = world_from_coil0 @ flange_from_coil.inverse()
    displacement = Transform.from_pose(dt_flange_m, torch.zeros(3).double())
    world_from_coil = world_from_flange0 @ displacement @ flange_from_coil
    sensor_world_m = torch.zeros(3, dtype=torch.float64)
    chain_m = world_from_coil.inverse().apply(sensor_world_m)

    formula_m = -flange_from_coil.unrotate(dt_flange_m) - world_from_coil0.unrotate(
        world_from_coil0.translation_m
    )
    torch.testing.assert_close(formula_m, chain_m)
    # The rotation of the mount matters, its offset does not.
    other_offset = Transform(flange_from_coil.rotation, flange_from_coil.translation_m + 1)
    moved = world_from_coil0 @ other_offset.inverse() @ displacement @ other_offset
    torch.testing.assert_close(moved.inverse().apply(sensor_world_m), chain_m)
    assert not torch.allclose(formula_m, -dt_flange_m - world_from_coil0.inverse().rotate(sensor_world_m))
