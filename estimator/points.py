"""Points as users have them: tensors, arrays, lists or labelled arrays, one or many; answers come back in the kind that was given."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from estimator.devices import numpy_of
from estimator.errors import InvalidInput, cut, quoted
from estimator.tensors import Tensor, torch

AXES = ("x", "y", "z")
KINDS = "[0.0, 0.0, 0.05], a NumPy array or a tensor of shape (n, 3), or an xarray.DataArray with x, y, z along one dimension"


class Points(NamedTuple):
    """Points, and what turns numbers for each into an answer.

    Attributes:
        points_m: In rows.
        answer: Takes values with the points on the first axis, then the coordinates; and what they are, with their unit.
    """

    points_m: Float[Tensor, "point 3"]
    answer: Callable[[Float[Tensor, "point ..."], str, str], Any]


def given_points(points: Any) -> Points:
    """Points in rows, and the way back.

    Args:
        points: In metres. A tensor keeps its device and precision; NumPy, lists and xarray are taken in double precision.
    Raises:
        InvalidInput: They are no numbers, or not three for each point; the sentence says what to pass.
    Examples:
        >>> given = given_points([0.0, 0.0, 0.05])
        >>> given.points_m.shape, given.answer(2.0 * given.points_m, "twice the place", "m")
        (torch.Size([1, 3]), [0.0, 0.0, 0.1])
    """
    if isinstance(points, Tensor):
        return _rows(points if points.is_floating_point() else points.double(), lambda values, *_: values)
    if hasattr(points, "dims") and hasattr(points, "coords"):
        return _labelled(points)
    try:
        array = np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidInput(f"points must be numbers, such as {KINDS}; received {quoted(points)}") from error
    if isinstance(points, list | tuple):
        return _rows(torch.from_numpy(array), lambda values, *_: type(points)(numpy_of(values).tolist()))
    array = array if array.flags.writeable else array.copy()  # as data frames give
    return _rows(torch.from_numpy(array), lambda values, *_: numpy_of(values))


def _rows(points_m: Tensor, answer: Callable[[Tensor, str, str], Any]) -> Points:
    if points_m.ndim == 0 or points_m.shape[-1] != 3:
        raise InvalidInput(
            f"points must have three coordinates each, such as {KINDS}; received shape {tuple(points_m.shape)}"
        )
    shape = points_m.shape[:-1]
    return Points(
        points_m.reshape(-1, 3),
        lambda values, name, unit: answer(values.reshape(*shape, *values.shape[1:]), name, unit),
    )


def _labelled(points: Any) -> Points:
    """Points of xarray: x, y and z stand along one dimension, whatever its name; the answer has dimensions and coordinates of theirs."""
    fits = [
        name
        for name in points.dims
        if points.sizes[name] == len(AXES)
        and (name not in points.coords or [str(label) for label in points[name].values] == list(AXES))
    ]
    fits = [name for name in fits if name in points.coords] or fits
    if len(fits) != 1:
        raise InvalidInput(
            "points must have one dimension with the coordinates x, y, z, as xarray.DataArray(rows, dims=('point', 'axis'), "
            f"coords={{'axis': ['x', 'y', 'z']}}); received dimensions {cut(str(dict(points.sizes)))}"
        )
    (along,) = fits
    last = points.transpose(..., along)
    others = tuple(last.dims[:-1])
    coords = {
        name: value
        for name, value in last.coords.items()
        if along not in value.dims and set(value.dims) <= set(others)
    }

    def answer(values: Tensor, name: str, unit: str) -> Any:
        more = ("component", "direction")[: values.ndim - len(others)]
        labels = {each: list(AXES) for each in more}
        attributes = {"units": unit, "long_name": name}
        return type(points)(
            numpy_of(values), dims=(*others, *more), coords={**coords, **labels}, attrs=attributes
        )

    return _rows(torch.from_numpy(np.asarray(last.values, dtype=np.float64)), answer)


def given_motion(motion: Any, like: Tensor) -> dict[str, Float[Tensor, "... 6"]]:
    """Motion of movers, as tensors on the device and in the precision of others.

    Args:
        motion: Six numbers by mover, as a tensor, an array or a list; or a row of six for each point.
        like: On the device and in the precision that are wanted.
    Raises:
        InvalidInput: It is no mapping, or holds no numbers.
    Examples:
        >>> given_motion({"arm1": [0.0, 0.0, 0.01, 0.0, 0.0, 0.0]}, torch.zeros(1))["arm1"].shape
        torch.Size([6])
    """
    example = "{'arm1': [0, 0, 0.01, 0, 0, 0]}"
    if not isinstance(motion or {}, Mapping):
        raise InvalidInput(f"motion must be given by mover, such as {example}; received {quoted(motion)}")
    rows = {}
    for name, numbers in (motion or {}).items():
        try:
            rows[name] = torch.as_tensor(
                numbers if isinstance(numbers, Tensor) else np.asarray(numbers, dtype=float)
            )
        except (TypeError, ValueError) as error:
            rule = f"motion of {name} must be six numbers, such as {example}"
            raise InvalidInput(f"{rule}; received {quoted(numbers)}") from error
    return {name: value.to(like) for name, value in rows.items()}
