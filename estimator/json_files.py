"""The only loader of JSON that comes from a file, and the seal of what coilcal writes and reads again.

JSON of Python's own takes NaN, keys that are given twice, halves of characters and numbers that overflow. None of these is written by
coilcal, and each would fail later, far from its file.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

from estimator.errors import CoilcalError, InvalidInput
from estimator.given_files import MOST_RESULT_BYTES, read_given, text_of

IS_SEALED, SEAL = "is_sealed", "sha256"
MOST_LEVELS = 100
MOST_SHOWN = 60  # characters of a refused value


def json_of(content: bytes | str, origin: Path | str, fault: type[CoilcalError] = InvalidInput) -> Any:
    """The value that a JSON text holds.

    Args:
        content: The text, in UTF-8.
        origin: File, and line where it is one, for messages.
        fault: What is raised.
    Raises:
        fault: It is no JSON; it holds NaN, an infinite number, a key twice or half a character; or it has more than `MOST_LEVELS` levels.
    Examples:
        >>> json_of('{"a": [1, 2.5]}', "truth.json")
        {'a': [1, 2.5]}
        >>> json_of('{"a": 1, "a": 2}', "truth.json")
        Traceback (most recent call last):
        ...
        estimator.errors.InvalidInput: truth.json must be JSON; key 'a' is given twice
    """
    text = text_of(content, origin, fault) if isinstance(content, bytes) else content
    try:
        value = _DECODER.decode(text)
        if _levels(value) > MOST_LEVELS:
            raise RecursionError
        if "\\ud" in text or "\\uD" in text:
            json.dumps(value, ensure_ascii=False).encode()
    except RecursionError:
        raise fault(f"{origin} must be JSON of at most {MOST_LEVELS} levels; it has more") from None
    except json.JSONDecodeError as error:
        line = f"line {error.lineno}, " if "\n" in text.strip() else ""
        words = f"{error.msg[:1].lower()}{error.msg[1:]} at {line}column {error.colno}"
        raise fault(f"{origin} must be JSON; {words}") from error
    except UnicodeEncodeError as error:
        raise fault(f"{origin} must be JSON of whole characters; it holds half a one") from error
    except ValueError as error:  # of the hooks, and of whole numbers with thousands of digits
        raise fault(f"{origin} must be JSON; {str(error).partition(';')[0]}") from error
    return value


def json_object(
    content: bytes | str, origin: Path | str, fault: type[CoilcalError] = InvalidInput
) -> dict[str, Any]:
    """The object that a JSON text holds; arguments and errors as for `json_of`, and another value is refused."""
    value = json_of(content, origin, fault)
    if not isinstance(value, dict):
        raise fault(f"{origin} must hold a JSON object; it holds {json.dumps(value)[:MOST_SHOWN]}")
    return value


def read_json(
    path: Path, most_bytes: int = MOST_RESULT_BYTES, fault: type[CoilcalError] = InvalidInput
) -> dict[str, Any]:
    """The object in a JSON file, whose seal is checked where it has one.

    Args:
        path, most_bytes, fault: As for `estimator.given_files.open_given`.
    Raises:
        fault: The file cannot be read, is no JSON object as `json_of` takes it, or does not match its seal.
    """
    rule = "must be readable as text"
    return unsealed(json_object(read_given(path, most_bytes, fault, rule), path, fault), path, fault)


def sealed(content: Mapping[str, Any], indent: int | None = None) -> str:
    """A JSON object as text, with its SHA-256 as last key, by which `unsealed` sees damage.

    Args:
        content: The object, of finite numbers.
        indent: Blanks of a level; None puts all on one line.
    Returns: Text that ends with a line feed.
    Examples:
        >>> unsealed(json_object(sealed({"radius_m": 0.05}), "result.json"), "result.json")
        {'radius_m': 0.05}
    """
    told = {**content, IS_SEALED: True}
    return json.dumps({**told, SEAL: _sha256(told)}, indent=indent, allow_nan=False) + "\n"


def unsealed(
    content: Mapping[str, Any], origin: Path | str, fault: type[CoilcalError] = InvalidInput
) -> dict[str, Any]:
    """The object without its seal. What version 0.2 wrote has none and is taken as it is.

    Args:
        content: The object with its seal.
        origin: File, and line where it is one, for messages.
        fault: What is raised.
    Raises:
        fault: Object and seal do not match.
    """
    told = dict(content)
    seal = told.pop(SEAL, None)
    if (seal is not None or IS_SEALED in told) and seal != _sha256(told):
        raise fault(f"{origin} must match its SHA-256; it was altered")
    told.pop(IS_SEALED, None)
    return told


def _sha256(content: Mapping[str, Any]) -> str:
    text = json.dumps(content, sort_keys=True, allow_nan=False)
    # Read back, lists and tuples are one, and so are keys that were numbers.
    return hashlib.sha256(json.dumps(json.loads(text), sort_keys=True).encode()).hexdigest()


def _levels(value: Any) -> int:
    """Levels of lists and objects inside each other, without recursion; it stops counting beyond the limit."""
    layer, n = [value], 0
    while layer and n <= MOST_LEVELS:
        layer = [
            inner
            for each in layer
            if isinstance(each, dict | list)
            for inner in (each.values() if isinstance(each, dict) else each)
            if isinstance(inner, dict | list)
        ]
        n += 1
    return n


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    if len(entries) != len(pairs):
        counts = Counter(name for name, _ in pairs)
        doubled = next(name for name, count in counts.items() if count > 1)
        raise ValueError(f"key {doubled[:MOST_SHOWN]!r} is given twice")
    return entries


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:MOST_SHOWN]} is no finite number")
    return value


def _refuse_constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is no finite number")


_DECODER = json.JSONDecoder(object_pairs_hook=_once, parse_float=_finite, parse_constant=_refuse_constant)
