"""Rotation matrices of rotation vectors and back, and vectors that are turned by them.

Everything broadcasts over leading axes, keeps dtype and device, and is differentiable. That includes zero rotation, where fits start and
the usual axis-angle formulas give NaN.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from jaxtyping import Float

from estimator.tensors import Tensor, torch

# Below this square of an angle (or of its sine) series replace the closed forms, whose derivatives lose
# digits there and are 0/0 at zero. The series stop at the first term below rounding.
_SMALL_SQUARE = 1e-3
_FEW = 4  # rotations that cost less as plain numbers than as tensors
_has_first_only: ContextVar[bool] = ContextVar("has_first_only", default=False)


@contextmanager
def first_derivatives_only(is_enough: bool = True) -> Iterator[None]:
    """While it lasts, a few rotations at a time have first derivatives only, at a fifth of the cost: forty operations less for each.

    Args:
        is_enough: Whether nothing needs second derivatives; else nothing changes.
    """
    token = _has_first_only.set(is_enough)
    try:
        yield
    finally:
        _has_first_only.reset(token)


def turned(
    rotation: Float[Tensor, "*#batch 3 3"], vectors: Float[Tensor, "*#batch 3"]
) -> Float[Tensor, "*#batch 3"]:
    """Every vector turned by its rotation; where all rows share one, by one product of matrices in half to a quarter of the time."""
    if rotation.dim() > 2 and rotation.shape[-3] == 1 and vectors.dim() > 1:
        return vectors @ rotation[..., 0, :, :].mT
    return (rotation @ vectors[..., None])[..., 0]


def turned_back(
    rotation: Float[Tensor, "*#batch 3 3"], vectors: Float[Tensor, "*#batch 3"]
) -> Float[Tensor, "*#batch 3"]:
    """Every vector turned back by its rotation. Products with rows take two thirds of the time of those with transposed matrices."""
    if rotation.dim() > 2 and rotation.shape[-3] == 1 and vectors.dim() > 1:
        return vectors @ rotation[..., 0, :, :]
    return (vectors[..., None, :] @ rotation)[..., 0, :]


def rotation_from_vector(rotation_vector_rad: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation matrix of a rotation vector v: turn by |v| about v, right-handed.

    Args:
        rotation_vector_rad: Axis times angle, of any length; (0, 0, 0) is no rotation and not a singular point.
    References: Rodrigues' formula R = cos(t) I + sin(t)/t [v]x + (1 - cos(t))/t^2 v v^T with t = |v|. The
        vector is the one in a pose p[x, y, z, rx, ry, rz] of Universal Robots' script manual.
    Examples:
        >>> rotation_from_vector(torch.tensor([0.0, 0.0, torch.pi / 2])).round().int().tolist()
        [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    """
    if rotation_vector_rad.numel() <= 3 * _FEW and _is_plain(rotation_vector_rad):
        entries = [_rotation_entries(*vector) for vector in rotation_vector_rad.reshape(-1, 3).tolist()]
        return torch.tensor(entries, dtype=torch.float64).reshape(*rotation_vector_rad.shape, 3)
    if (
        _has_first_only.get()
        and rotation_vector_rad.numel() <= 3 * _FEW
        and _may_be_numbers(rotation_vector_rad)
    ):
        return _with_first_derivatives(rotation_vector_rad)
    # The coefficients are smooth in t^2, whereas t has a kink at 0.
    square = rotation_vector_rad.square().sum(-1)
    small = square < _SMALL_SQUARE
    # where() also differentiates the branch not taken, which must be finite, or the gradient is NaN.
    angle = square.where(~small, 1.0).sqrt()
    sinc = torch.where(small, 1 - square / 6 * (1 - square / 20 * (1 - square / 42)), angle.sin() / angle)
    versine = torch.where(
        small,
        (1 - square / 12 * (1 - square / 30 * (1 - square / 56))) / 2,
        2 * ((angle / 2).sin() / angle).square(),  # (1 - cos(t))/t^2 without its cancellation
    )
    x, y, z = (sinc[..., None] * rotation_vector_rad).unbind(-1)
    zero = torch.zeros_like(x)
    cross = _square_matrix(zero, -z, y, z, zero, -x, -y, x, zero)
    outer = rotation_vector_rad[..., :, None] * rotation_vector_rad[..., None, :]
    eye = torch.eye(3, dtype=outer.dtype, device=outer.device)
    return (1 - versine * square)[..., None, None] * eye + cross + versine[..., None, None] * outer


def _is_plain(tensor: Tensor) -> bool:
    """Whether a tensor is numbers on the processor, in double precision, which nothing differentiates or traces."""
    return _may_be_numbers(tensor) and not tensor.requires_grad


def _may_be_numbers(tensor: Tensor) -> bool:
    """Whether a tensor is numbers on the processor, in double precision, that nothing but a backward pass differentiates or traces."""
    return (
        type(tensor) is torch.Tensor
        and tensor.dtype == torch.float64
        and tensor.device.type == "cpu"
        and not torch.compiler.is_compiling()
        and not torch._C._functorch.is_functorch_wrapped_tensor(tensor)
        and torch.autograd.forward_ad.unpack_dual(tensor).tangent is None
    )


def _with_first_derivatives(rotation_vector_rad: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """The rotation matrices with exact values and first derivatives, but without second ones."""
    shape, vectors = rotation_vector_rad.shape, rotation_vector_rad.detach().reshape(-1, 3).tolist()
    value = rotation_vector_rad.new_tensor([_rotation_entries(*vector) for vector in vectors])
    slopes = rotation_vector_rad.new_tensor([_rotation_slopes(*vector) for vector in vectors])
    # The difference is zero and carries the derivative.
    change = (
        slopes.reshape(*shape[:-1], 9, 3) @ (rotation_vector_rad - rotation_vector_rad.detach())[..., None]
    )
    return (value.reshape(*shape[:-1], 9) + change[..., 0]).unflatten(-1, (3, 3))


def _rotation_entries(x: float, y: float, z: float) -> tuple[float, ...]:
    """Entries of one rotation matrix, row by row, by the same formula."""
    square = x * x + y * y + z * z
    sinc, versine, _, _ = _coefficients(square)
    cosine = 1 - versine * square
    a, b, c = sinc * x, sinc * y, sinc * z
    xy, xz, yz = versine * x * y, versine * x * z, versine * y * z
    return (
        *(cosine + versine * x * x, xy - c, xz + b),
        *(xy + c, cosine + versine * y * y, yz - a),
        *(xz - b, yz + a, cosine + versine * z * z),
    )


def _coefficients(square: float) -> tuple[float, float, float, float]:
    """sin(t)/t and (1 - cos(t))/t^2 of the square of an angle, and their derivatives in that square."""
    if square < _SMALL_SQUARE:
        return (
            1 - square / 6 * (1 - square / 20 * (1 - square / 42)),
            (1 - square / 12 * (1 - square / 30 * (1 - square / 56))) / 2,
            -(1 - square / 10 * (1 - square / 28)) / 6,
            -(1 - square / 15 * (1 - 3 * square / 112)) / 24,
        )
    angle = math.sqrt(square)
    sinc, versine = math.sin(angle) / angle, 2 * (math.sin(angle / 2) / angle) ** 2
    return sinc, versine, (math.cos(angle) - sinc) / (2 * square), (sinc - 2 * versine) / (2 * square)


def _rotation_slopes(x: float, y: float, z: float) -> list[tuple[float, float, float]]:
    """Derivatives of these entries in x, y and z, entry by entry."""
    v = (x, y, z)
    sinc, versine, of_sinc, of_versine = _coefficients(x * x + y * y + z * z)
    cross = ((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))
    slopes = []
    for i in range(3):
        for j in range(3):
            by = 2 * (of_sinc * cross[i][j] + of_versine * v[i] * v[j]) - (sinc if i == j else 0.0)
            own = [by * v[k] + versine * ((i == k) * v[j] + (j == k) * v[i]) for k in range(3)]
            if i != j:
                k = 3 - i - j
                own[k] += sinc * (-1.0 if (j - i) % 3 == 1 else 1.0)
            slopes.append((own[0], own[1], own[2]))
    return slopes


def vector_from_rotation(rotation: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 3"]:
    """Rotation vector of a rotation matrix: the inverse of `rotation_from_vector`, no longer than pi.

    Args:
        rotation: Orthonormal, determinant +1. A half turn about v is one about -v; either may be returned.
    References: S. W. Shepperd, J. Guidance and Control 1 (1978) 223: sums of entries of R are the entries of
        4 q q^T for its unit quaternion q. The largest row gives q with full accuracy, also at angles 0 and
        pi, where the trace or the antisymmetric part alone fail.
    Examples:
        >>> vector_from_rotation(torch.diag(torch.tensor([1.0, -1.0, -1.0]).double()))
        tensor([3.1416, 0.0000, 0.0000], dtype=torch.float64)
    """
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation.flatten(-2).unbind(-1)
    ww, xx, yy, zz = 1 + r00 + r11 + r22, 1 + r00 - r11 - r22, 1 - r00 + r11 - r22, 1 - r00 - r11 + r22
    wx, wy, wz = r21 - r12, r02 - r20, r10 - r01
    xy, xz, yz = r01 + r10, r02 + r20, r12 + r21
    products = _square_matrix(ww, wx, wy, wz, wx, xx, xy, xz, wy, xy, yy, yz, wz, xz, yz, zz)
    largest = torch.stack([ww, xx, yy, zz], -1).argmax(-1)[..., None, None]
    row = products.take_along_dim(largest, -2)[..., 0, :]
    quaternion = row / row.square().sum(-1, keepdim=True).sqrt()
    quaternion = torch.where(quaternion[..., :1] < 0, -quaternion, quaternion)  # the shorter rotation
    cosine, imaginary = quaternion[..., 0], quaternion[..., 1:]  # cos(t/2) and the axis times sin(t/2)
    square = imaginary.square().sum(-1)
    small = square < _SMALL_SQUARE
    sine = square.where(~small, 1.0).sqrt()
    scale = torch.where(  # t / sin(t/2), its series being that of the arcsine
        small,
        2 + square / 3 * (1 + square * 9 / 20 * (1 + square * 25 / 42 * (1 + square * 49 / 72))),
        2 * torch.atan2(sine, cosine) / sine,
    )
    return scale[..., None] * imaginary


def _square_matrix(*entries: Tensor) -> Tensor:
    """Matrix from its entries, row by row."""
    size = round(len(entries) ** 0.5)
    return torch.stack(entries, -1).reshape(*entries[0].shape, size, size)
