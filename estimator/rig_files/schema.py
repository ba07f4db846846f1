"""JSON Schema of rig files, for editors: it is what the reader asks for while it reads a file with every kind of part.

So there is no second list of keys. A schema cannot say all that the reader checks (ties, geometry, names); the reader has the last word.
"""

from __future__ import annotations

from typing import Any

import yaml

from estimator.effects import EFFECTS
from estimator.effects.circumstances import Extent
from estimator.rig.bodies import Region
from estimator.rig.harmonic_terms import HIGHEST_DEGREE
from estimator.rig_files.read import JOINT, NAME, SCHEMA_VERSION, read_rig
from estimator.units import split_unit
from estimator.yaml_loader import Loader
from estimator.yaml_section import Section

NAMED = ("movers", "coils", "sensors")  # what stands below has names of the user's
FREE_NUMBER = "number"
BY_UNIT = ("corrections", "devices", JOINT)  # checked by their own readers

# Every kind of mover, coil, sensor, number and prior, so that the reader takes each of its branches once.
TABLE = ", ".join(f"{column}: [0, 0, 0, 0, 0, 0]" for column in ("theta_rad", "a_m", "d_m", "alpha_rad"))
SPECIMEN = f"""
schema_version: {SCHEMA_VERSION}
name: specimen
movers:
  shifts: {{motion: displacement, displacement_frame: base, base_from_flange0: {{rx_rad: 0}}}}
  poses: {{motion: pose}}
  turns: {{motion: joints, denavit_hartenberg: {{{TABLE}, base_from_first: {{}}, last_from_flange: {{}}}}}}
  measured: {{motion: UR5e, factory_corrections: {{{TABLE}}}}}
coils:
  shifted:
    {{carried_by: shifts, radius_m: {{value: 0.05, prior: {{normal: {{mean: 0.05, sd: 0.01}}}}}},
    wire_radius_m: 0.0005, axial_loops: 10, radial_loops: 2, current_gain: 1,
    lead_in_m: [[0.3, 0, 0], [0.05, 0, 0]], lead_out_m: [[0.05, 0, 0], [0.3, 0, 0]]}}
  carried:
    {{carried_by: poses, radius_m: {{prior: {{uniform: {{lower: 0.04, upper: 0.06}}}}}}, axial_pitch_m: 0.001, radial_pitch_m: 0.001,
    axial_loops: 10, radial_loops: 2}}
  standing: {{radius_m: {{tied_to: shifted.radius_m}}, wire_radius_m: 0.0005, axial_loops: 10, radial_loops: 2}}
  sided: {{model: racetrack, inner_side_x_m: 0.06, inner_side_y_m: 0.04, inner_corner_radius_m: 0.01, wire_radius_m: 0.0005,
    axial_loops: 10, radial_loops: 2}}
  inside:
    {{model: harmonic, region: {Region.INTERIOR}, degree: {HIGHEST_DEGREE}, reference_radius_m: 0.04,
    amplitudes: {{sd_T_per_A: 1e-3, degree1_cos0_T_per_A: 0}}}}
  boxed:
    {{model: equivalent_sources, half_x_m: 0.01, half_y_m: 0.01, half_z_m: 0.01, margin_m: 0.01, spacing_m: 0.04,
    multipoles_m: [[0, 0, 0.02]], amplitudes: {{sd_T_per_A: 1e-3}}}}
sensors:
  standing_sensor: {{noise_T: {{prior: {{log_normal: {{median: 1e-5, relative_sd: 0.5}}}}}}}}
  shifted_sensor: {{carried_by: shifts, noise_T: 1e-5, gain: 1}}
  carried_sensor: {{carried_by: poses, noise_T: 1e-5}}
"""


def rig_schema() -> dict[str, Any]:
    """The schema, draft 2020-12.

    Examples:
        >>> schema = rig_schema()
        >>> schema["properties"]["sensors"]["additionalProperties"]["properties"]["noise_uT"]
        {'$ref': '#/$defs/number'}
        >>> schema["properties"]["movers"]["additionalProperties"]["properties"]["motion"]["enum"]
        ['pose', 'displacement', 'joints', 'UR3', 'UR5', 'UR10', 'UR3e', 'UR5e', 'UR10e', 'UR16e', 'UR20']
    """
    asked = _Asked.of_text(SPECIMEN)
    read_rig(asked)
    schema = _mapping(asked.book, "")
    number = {"oneOf": [{"type": "number"}, _mapping(asked.book, FREE_NUMBER)]}
    properties = schema["properties"]
    properties["schema_version"] = {"const": SCHEMA_VERSION}
    properties["name"] = properties["description"] = {"type": "string"}
    properties["effects"] = {"type": "object", "patternProperties": _causes(), "additionalProperties": False}
    properties |= {key: {"type": "object"} for key in BY_UNIT}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "coilcal rig file",
        **schema,
        "$defs": {"number": number},
    }


def _causes() -> dict[str, Any]:
    """Entries `cause[place]` with their quantities, by a pattern."""
    return {
        rf"^{effect.name}\[{NAME.pattern}\]$": {
            "type": "object",
            "description": effect.words,
            "properties": {q.key: {"$ref": "#/$defs/number"} for q in effect.quantities(Extent())},
        }
        for effect in EFFECTS.values()
        if not effect.is_correction
    }


class _Asked(Section):
    """A section that notes in a book, by where it stands, which keys its reader asks for and what they may hold."""

    book: dict[str, dict[str, Any]]
    pattern: str

    @classmethod
    def of_text(cls, text: str) -> _Asked:
        """The top of a file."""
        node = Loader(text, "specimen").get_single_node()
        assert isinstance(node, yaml.MappingNode)
        return cls(node, "", "specimen")._at({}, "")

    def _at(self, book: dict[str, dict[str, Any]], pattern: str) -> _Asked:
        self.book, self.pattern = book, pattern
        book.setdefault(pattern, {})
        return self

    def _note(self, key: str, holds: dict[str, Any]) -> None:
        """What a key may hold; what is known more exactly stays."""
        notes = self.book[self.pattern]
        notes[key] = notes.get(key) or holds

    def _below(self, node: yaml.MappingNode, key: str, path: str) -> Section:
        is_number = "$ref" in self.book[self.pattern].get(key, {})
        below = (
            FREE_NUMBER
            if is_number
            else f"{self.pattern}.*"
            if self.pattern[1:] in NAMED
            else f"{self.pattern}.{key}"
        )
        if not is_number:
            self._note(key, {"below": below})
        return _Asked(node, path, self.file)._at(self.book, below)

    def __contains__(self, key: str) -> bool:
        self._note(key, {})
        return super().__contains__(key)

    def value(self, key: str, default: Any = None) -> Any:
        """Text, where nothing else is asked of it."""
        value = super().value(key, default)
        if isinstance(value, str):
            self._note(key, {"type": "string"})
        if isinstance(value, list):  # in whatever unit
            stem, unit = split_unit(key)
            for symbol in self.symbols(unit.dimension) if unit else ():
                self.book[self.pattern][f"{stem}_{symbol}"] = {"type": "array"}
        return value

    def is_section(self, key: str) -> bool:
        """A key that may hold a mapping instead of a number."""
        self._note(key, {"$ref": "#/$defs/number"})
        return super().is_section(key)

    def has_quantity(self, quantity: str, dimension: str) -> bool:
        """One key for each unit."""
        self._note_units(quantity, dimension)
        return super().has_quantity(quantity, dimension)

    def key_with_unit(self, quantity: str, dimension: str) -> Any:
        """One key for each unit."""
        self._note_units(quantity, dimension)
        return super().key_with_unit(quantity, dimension)

    def _note_units(self, quantity: str, dimension: str) -> None:
        for symbol in self.symbols(dimension):
            self._note(f"{quantity}_{symbol}", {"$ref": "#/$defs/number"})

    def number(self, key: str, default: float | None = None) -> float:
        """A plain number."""
        self._note(key, {"type": "number"} if default is None else {"type": "number", "default": default})
        return super().number(key, default)

    def choice(self, key: str, choices: tuple[str, ...], default: str | None = None) -> str:
        """One of some words."""
        told = {"enum": [str(choice) for choice in choices]}
        self._note(key, told if default is None else {**told, "default": str(default)})
        return super().choice(key, choices, default)

    def flag(self, key: str) -> bool:
        """True or false."""
        self._note(key, {"type": "boolean", "default": False})
        return super().flag(key)


def _mapping(book: dict[str, dict[str, Any]], pattern: str) -> dict[str, Any]:
    """The schema of what stands in one kind of place."""
    if pattern[1:] in NAMED:
        return {
            "type": "object",
            "propertyNames": {"pattern": f"^{NAME.pattern}$"},
            "additionalProperties": _mapping(book, f"{pattern}.*"),
        }
    properties = {
        key: _mapping(book, holds["below"]) if "below" in holds else holds
        for key, holds in book[pattern].items()
    }
    return {"type": "object", "properties": properties, "additionalProperties": False}
