"""Columns of a JSON text: records, one a line or in a list, or a list for each column."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain
from typing import Any

from estimator.errors import InvalidInput
from estimator.json_files import json_of


def columns_in(text: str) -> dict[str, list[Any]]:
    """Values by column, None where a record lacks one.

    Raises:
        ValueError, InvalidInput: It is no JSON.
    Examples:
        >>> columns_in('{"t_s": 0, "B": {"x_mT": 1}}' + chr(10) + '{"t_s": 1}')
        {'t_s': [0, 1], 'B_x_mT': [1, None]}
        >>> columns_in('{"rig": "bench", "readings": [{"t_s": 0}]}'), columns_in('{"t_s": [0, 1], "rig": "bench"}')
        ({'t_s': [0]}, {'t_s': [0, 1]})
    """
    try:
        content = json_of(text, "readings")
    except InvalidInput:
        content = [json_of(line, "readings") for line in text.splitlines() if line.strip()]
    if isinstance(content, dict):
        content = next((value for value in content.values() if _are_records(value)), content)
    if _are_records(content):
        records = [_unnested(record) for record in content]
        content = {key: [record.get(key) for record in records] for key in dict.fromkeys(chain(*records))}
    if not isinstance(content, dict):
        raise ValueError
    return {key: values for key, values in content.items() if isinstance(values, list)}


def _are_records(value: object) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(each, dict) for each in value)


def _unnested(record: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """A record whose parts are records, as one."""
    parts: dict[str, Any] = {}
    for key, value in record.items():
        parts |= _unnested(value, f"{before}{key}_") if isinstance(value, dict) else {f"{before}{key}": value}
    return parts
