"""Table of the keys of a rig file, from their schema, for the reference; `make docs` runs it before the site is built."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from estimator.rig_files.schema import rig_schema
from estimator.units import split_unit

SHOWN_UNITS = ("mm", "deg", "uT")
POSE = {"x_mm", "tilt_x_deg"}
AMPLITUDE = re.compile(r"degree(?!1_cos0_|$)")  # of hundreds the first is shown
NUMBER = {"$ref": "#/$defs/number"}


def rows(schema: dict[str, Any], path: str = "") -> Iterator[tuple[str, str]]:
    """Dotted key and what it holds; of keys that differ in their unit alone one is given."""
    for key, holds in schema.get("properties", {}).items():
        below = holds.get("additionalProperties")
        if is_in_another_unit(key, schema["properties"]) or AMPLITUDE.match(key):
            continue
        if isinstance(below, dict):
            yield from rows(below, f"{path}{key}.*.")
        elif set(holds.get("properties", {})) >= POSE:
            yield f"{path}{key}", "a [pose](../how-to/write-a-rig-file.md#poses)"
        elif "properties" in holds:
            yield from rows(holds, f"{path}{key}.")
        else:
            yield f"{path}{key}", words(holds)


def is_in_another_unit(key: str, keys: dict[str, Any]) -> bool:
    """Whether the same quantity is there in the unit that is shown."""
    quantity, unit = split_unit(key)
    others = {f"{quantity}_{symbol}" for symbol in SHOWN_UNITS} & set(keys)
    return unit is not None and bool(others) and key not in others


def words(holds: dict[str, Any]) -> str:
    """What a key holds, in words."""
    default = f"; `{holds['default']}` where left out".lower() if "default" in holds else ""
    if holds == NUMBER:
        return "number"
    if "enum" in holds:
        return " or ".join(f"`{choice}`" for choice in holds["enum"]) + default
    if "const" in holds:
        return f"`{holds['const']}`"
    kinds = {
        "boolean": "`true` or `false`",
        "number": "a plain number",
        "string": "text",
        "object": "a section",
    }
    return kinds.get(holds.get("type", ""), "a name or a number") + default


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/reference/rig-keys.txt"))
    lines = [f"| `{key}` | {holds} |" for key, holds in rows(rig_schema())]
    table = "\n".join(["| key | holds |", "|---|---|", *lines])
    parser.parse_args().out.write_text(f"{table}\n", encoding="utf-8")
    print(f"{len(lines)} keys of rig files")


if __name__ == "__main__":
    main()
