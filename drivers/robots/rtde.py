"""Encodes and decodes packages of Universal Robots' real-time data exchange (RTDE, TCP port 30004).

Protocol: "Real-Time Data Exchange (RTDE) Guide", Universal Robots. A package is `uint16 size, uint8 type, payload`, big-endian,
where the size counts its own three bytes of header.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from typing import TypeAlias

from drivers.errors import DeviceFault

PORT = 30004

_HEADER = struct.Struct(">HB")

Value: TypeAlias = bool | int | float | tuple[int, ...] | tuple[float, ...]

_FORMATS = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}


class PackageType(IntEnum):
    """Type of a package: the letter after its size."""

    REQUEST_PROTOCOL_VERSION = ord("V")
    GET_CONTROLLER_VERSION = ord("v")
    TEXT_MESSAGE = ord("M")
    DATA = ord("U")
    SET_UP_OUTPUTS = ord("O")
    SET_UP_INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


_LETTERS = frozenset(PackageType)


@dataclass(frozen=True, slots=True)
class Package:
    """One package without its header."""

    type: PackageType
    payload: bytes


def encode(package: Package) -> bytes:
    r"""A package with its header.

    Examples:
        >>> encode(Package(PackageType.REQUEST_PROTOCOL_VERSION, bytes([0, 2])))
        b'\x00\x05V\x00\x02'
    """
    return _HEADER.pack(_HEADER.size + len(package.payload), package.type) + package.payload


def split(stream: bytes) -> tuple[list[Package], bytes]:
    r"""Whole packages of a stream, and the rest.

    Raises:
        DeviceFault: The stream is not RTDE.

    Examples:
        >>> split(b"\x00\x04S\x01\x00\x04")
        ([Package(type=<PackageType.START: 83>, payload=b'\x01')], b'\x00\x04')
    """
    packages, start = [], 0
    while len(stream) - start >= _HEADER.size:
        size, letter = _HEADER.unpack_from(stream, start)
        if size < _HEADER.size or letter not in _LETTERS:
            raise DeviceFault(f"RTDE must send packages; received {stream[start : start + 20]!r}")
        if len(stream) - start < size:
            break
        packages.append(Package(PackageType(letter), stream[start + _HEADER.size : start + size]))
        start += size
    return packages, stream[start:]


@dataclass(frozen=True, slots=True)
class Recipe:
    """Variables of a data package, in their order.

    Attributes:
        number: Number assigned by the controller.
        names: Names of the variables.
        types: Types in the controller's notation.
    """

    number: int
    names: tuple[str, ...]
    types: tuple[str, ...]


def encode_output_request(names: Sequence[str], frequency_Hz: float) -> Package:
    r"""Request variables at a rate (protocol version 2).

    Examples:
        >>> encode_output_request(["timestamp"], 500.0).payload
        b'@\x7f@\x00\x00\x00\x00\x00timestamp'
    """
    return Package(
        PackageType.SET_UP_OUTPUTS, struct.pack(">d", frequency_Hz) + ",".join(names).encode("ascii")
    )


def decode_recipe(payload: bytes, names: Sequence[str]) -> Recipe:
    r"""The answer to a request for variables.

    Raises:
        DeviceFault: The controller does not know a variable, or an input is in use by another client.

    Examples:
        >>> decode_recipe(b"\x01DOUBLE,VECTOR6D", ["timestamp", "actual_q"]).types
        ('DOUBLE', 'VECTOR6D')
    """
    types = tuple(payload[1:].decode("ascii", "replace").split(","))
    if len(types) != len(names) or any(kind not in _FORMATS for kind in types):
        refused = [f"{name} {kind}" for name, kind in zip(names, types, strict=False) if kind not in _FORMATS]
        raise DeviceFault(
            f"RTDE must know all requested variables; it says {', '.join(refused) or repr(payload)}"
        )
    return Recipe(payload[0], tuple(names), types)


def decode_data(payload: bytes, recipe: Recipe) -> dict[str, Value]:
    """Values of a data package, all of one control cycle.

    Raises:
        DeviceFault: The package belongs to another recipe, or is cut short.

    Examples:
        >>> recipe = Recipe(1, ("timestamp", "runtime_state"), ("DOUBLE", "UINT32"))
        >>> decode_data(encode_data(recipe, [0.5, 2]).payload, recipe)
        {'timestamp': 0.5, 'runtime_state': 2}
    """
    layout = _layout(recipe.types)
    if len(payload) != layout.size or payload[0] != recipe.number:
        raise DeviceFault(
            f"RTDE must send recipe {recipe.number} of {layout.size} bytes; received {payload[:20]!r}"
        )
    flat = list(layout.unpack(payload))[1:]
    values: dict[str, Value] = {}
    for name, kind in zip(recipe.names, recipe.types, strict=True):
        length = _length(kind)
        values[name] = tuple(flat[:length]) if kind.startswith("VECTOR") else flat[0]
        del flat[:length]
    return values


def encode_data(recipe: Recipe, values: Sequence[Value]) -> Package:
    """A data package, as the controller or a client sends it."""
    flat: list[bool | int | float] = []
    for value in values:
        flat.extend(value if isinstance(value, tuple) else (value,))
    return Package(PackageType.DATA, _layout(recipe.types).pack(recipe.number, *flat))


@cache
def _layout(types: tuple[str, ...]) -> struct.Struct:
    """Binary layout of the payload of a data package: the number of the recipe, then values of these types."""
    return struct.Struct(">B" + "".join(_FORMATS[kind] for kind in types))


def _length(kind: str) -> int:
    return {"VECTOR3D": 3}.get(kind, 6) if kind.startswith("VECTOR") else 1
