"""Points as users have them: tensors, arrays, lists or labelled arrays, one or many; answers come back in the kind that was given."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from estimator.devices import numpy_of
from estimator.errors import InvalidInput, cut, quoted
from estimator.tensors import Tensor, torch

AXES = ("x", "y", "z")
KINDS = "[0.0, 0.0, 0.05], a NumPy array or a tensor of shape (n, 3), or an xarray.DataArray with x, y, z along one dimension"


class Answer(NamedTuple):
    """Numbers at a point: what they are, their unit, and the labels of each of their axes by its name."""

    name: str
    unit: str
    axes: Mapping[str, Sequence[str]]

    def end_of_interval(self, which: str, level: float) -> Answer:
        """The lower or upper end of a credible interval of these numbers."""
        return self._replace(name=f"{which} end of the {100.0 * level:g} % interval of the {self.name}")


FIELD = Answer("magnetic flux density", "T", {"component": AXES})
GRADIENT = Answer("field gradient", "T/m", {"component": AXES, "direction": AXES})


class Points(NamedTuple):
    """Points, and what turns numbers for each into an answer.

    Attributes:
        points_m: In rows.
        shape: Of the points as they were given, without their coordinates.
        as_given: Takes numbers in which that shape stands before the axes of an answer.
    """

    points_m: Float[Tensor, "point 3"]
    shape: tuple[int, ...]
    as_given: Callable[[Float[Tensor, "..."], Answer], Any]

    def answer(self, values: Float[Tensor, "..."], what: Answer) -> Any:
        """Numbers for each point in the kind of the points.

        Args:
            values: The axis of the points stands before those of the answer, behind those of a batch.
            what: They are.
        """
        n_before = values.ndim - 1 - len(what.axes)
        shape = (*values.shape[:n_before], *self.shape, *values.shape[n_before + 1 :])
        return self.as_given(values.reshape(shape), what)


def given_points(points: Any, what: str = "points") -> Points:
    """Points in rows, and the way back.

    Args:
        points: In metres; or other vectors. A tensor keeps its device and precision; NumPy, lists and xarray are taken in double
            precision.
        what: They are.
    Raises:
        InvalidInput: They are no numbers, or not three for each point; the sentence says what to pass.
    Examples:
        >>> given = given_points([0.0, 0.0, 0.05])
        >>> given.points_m.shape, given.answer(2.0 * given.points_m, Answer("twice the place", "m", {"component": AXES}))
        (torch.Size([1, 3]), [0.0, 0.0, 0.1])
    """
    if isinstance(points, Tensor):
        tensor = points if points.is_floating_point() else points.double()
        return _rows(tensor, lambda values, *_: values, what)
    if hasattr(points, "dims") and hasattr(points, "coords"):
        return _labelled(points, what)
    tensor = given_numbers(points, f"{what} must be numbers, such as {KINDS}")
    if isinstance(points, list | tuple):
        return _rows(tensor, lambda values, *_: type(points)(numpy_of(values).tolist()), what)
    return _rows(tensor, lambda values, *_: numpy_of(values), what)


def given_numbers(numbers: Any, rule: str) -> Tensor:
    """Numbers of any kind as a tensor; a tensor stays as it is, others come in double precision.

    Args:
        numbers: A tensor, an array, a list or a number.
        rule: What they must be.
    Raises:
        InvalidInput: They are no numbers.
    """
    if isinstance(numbers, Tensor):
        return numbers
    try:
        array = np.asarray(numbers, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidInput(f"{rule}; received {quoted(numbers)}") from error
    return torch.from_numpy(array if array.flags.writeable else array.copy())  # as data frames give


def _rows(points_m: Tensor, as_given: Callable[[Tensor, Answer], Any], what: str) -> Points:
    if points_m.ndim == 0 or points_m.shape[-1] != 3:
        raise InvalidInput(
            f"{what} must have three coordinates each, such as {KINDS}; received shape {tuple(points_m.shape)}"
        )
    return Points(points_m.reshape(-1, 3), tuple(points_m.shape[:-1]), as_given)


def _labelled(points: Any, what: str) -> Points:
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
            f"{what} must have one dimension with the coordinates x, y, z, as xarray.DataArray(rows, dims=('point', 'axis'), "
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

    def as_given(values: Tensor, answer: Answer) -> Any:
        batch = (f"batch{i}" for i in range(values.ndim - len(others) - len(answer.axes)))
        return type(points)(
            numpy_of(values),
            dims=(*batch, *others, *answer.axes),
            coords={**coords, **{axis: list(labels) for axis, labels in answer.axes.items()}},
            attrs={"units": answer.unit, "long_name": answer.name},
        )

    return _rows(torch.from_numpy(np.asarray(last.values, dtype=np.float64)), as_given, what)


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
    return {
        name: given_numbers(numbers, f"motion of {name} must be six numbers, such as {example}").to(like)
        for name, numbers in (motion or {}).items()
    }
