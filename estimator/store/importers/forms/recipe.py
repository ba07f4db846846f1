"""A recipe: how the files of one instrument or script are read. `coilcal import` writes it as columns.yaml, and `--map` reads it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from estimator.errors import InvalidInput, quoted
from estimator.readings.clock import Clock
from estimator.store.importers.forms.layout import WORDS
from estimator.units import LARGEST
from estimator.yaml_section import Section

SEPARATOR_OF = {word: separator for separator, word in WORDS.items()}
DECIMALS = {"point": ".", "comma": ","}
PLAIN = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?$")
CLOCK, DATE, NOTHING = "clock", "date", "-"
AND = ", "  # between the names of a column that is several, as the current of windings in series
ABOUT = """\
# How coilcal reads such files: the name of each column in the file, and what it is (units by suffix; "clock" is a time of day,
# "-" is left out). Use it with: coilcal import FILE --rig RIG --map columns.yaml
"""


@dataclass(frozen=True)
class Recipe:
    """How files are read; what is not given is found in the file.

    Attributes:
        columns: What each column of the file is: a column of the readings CSV with its unit, several with commas between them, `clock`,
            `date`, or `-`.
        constants: Numbers of columns that the file does not have, such as `coil1_current_A`.
        separator: In words, such as `semicolons`.
        decimal: `point` or `comma`.
        encoding: As Python names it.
        sheet: Of a workbook.
        clock: How times are read.
        skips_bad: Whether rows with a fault are left out.
        is_whole: Whether columns that are not listed are left out, and nothing is guessed.
        origin: File that it comes from, for messages.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    constants: Mapping[str, float] = field(default_factory=dict)
    separator: str | None = None
    decimal: str | None = None
    encoding: str | None = None
    sheet: str | None = None
    clock: Clock = Clock.AS_WRITTEN
    skips_bad: bool = False
    is_whole: bool = False
    origin: str = ""

    @property
    def is_plain(self) -> bool:
        """Whether it asks for nothing that a readings CSV does not have by itself."""
        return not (
            self.columns or self.constants or self.separator or self.decimal or self.encoding or self.sheet
        )

    def text(self) -> str:
        """The recipe as YAML."""
        lines = [ABOUT + "schema_version: 1", "columns:"]
        lines += [f"  {_key(header)}: {_key(name)}" for header, name in self.columns.items()]
        if self.constants:
            lines += ["constants:", *(f"  {name}: {value!r}" for name, value in self.constants.items())]
        given = {
            "separator": self.separator,
            "decimal": self.decimal,
            "encoding": self.encoding,
            "sheet": self.sheet,
            "clock": None if self.clock is Clock.AS_WRITTEN else str(self.clock),
        }
        lines += [f"{key}: {_key(value)}" for key, value in given.items() if value is not None]
        if self.skips_bad:
            lines.append("skip_bad_lines: true")
        return "\n".join(lines) + "\n"


def _key(text: str) -> str:
    """A text as YAML, in quotes where it is more than letters."""
    return (
        text
        if text.replace("_", "a").isalnum() and text[0].isalpha()
        else json.dumps(text, ensure_ascii=False)
    )


def read_recipe(path: Path) -> Recipe:
    """Read a recipe.

    Raises:
        InvalidInput: The file cannot be read or breaks a rule; the sentence names file and line.
    """
    section = Section.from_file(path)
    if (version := section.value("schema_version", 1)) != 1:
        section.refuse("schema_version", "must be 1", version)
    columns = section.section("columns")
    constants = section.section("constants") if "constants" in section else None
    for key in ("separator", "decimal", "encoding", "sheet"):
        if key in section and not isinstance(section.value(key), str):
            section.refuse(key, "must be a word", section.value(key))
    recipe = Recipe(
        {header: _name(columns, header) for header in columns},
        {} if constants is None else {name: constants.number(name) for name in constants},
        section.choice("separator", tuple(SEPARATOR_OF)) if "separator" in section else None,
        section.choice("decimal", tuple(DECIMALS)) if "decimal" in section else None,
        section.value("encoding"),
        section.value("sheet"),
        Clock(section.choice("clock", tuple(Clock), Clock.AS_WRITTEN)),
        section.flag("skip_bad_lines") if "skip_bad_lines" in section else False,
        is_whole=True,
        origin=str(path),
    )
    for each in (columns, constants, section):
        if each is not None:
            each.finish()
    return recipe


def _name(columns: Section, header: str) -> str:
    value = columns.value(header)
    if value is None:
        return NOTHING
    if not isinstance(value, str):
        columns.refuse(header, "must be the name of a column, clock, date, or -", value)
    return value


def parts_of(name: str) -> list[str]:
    """The names in what a column is.

    Examples:
        >>> parts_of("x1_current_A, x2_current_A")
        ['x1_current_A', 'x2_current_A']
    """
    return [part.strip() for part in name.split(AND.strip())]


def together(named: Iterable[tuple[str, str]]) -> dict[str, str]:
    """What each column is, from its header and one of its names in each pair.

    Examples:
        >>> together([("I [A]", "x1_current_A"), ("t", "t_s"), ("I [A]", "x2_current_A")])
        {'I [A]': 'x1_current_A, x2_current_A', 't': 't_s'}
    """
    columns: dict[str, str] = {}
    for header, name in named:
        columns[header] = f"{columns[header]}{AND}{name}" if header in columns else name
    return columns


def named_columns(texts: Sequence[str]) -> dict[str, str]:
    """Columns of the option `--column`, such as `Bx [G]=Bx_G`, or `Comment=-` for one that is left out.

    Raises:
        InvalidInput: A text has another form.
    Examples:
        >>> named_columns(["a = b (mT)=Bx_mT"])
        {'a = b (mT)': 'Bx_mT'}
    """
    columns: dict[str, str] = {}
    for text in texts:
        header, sign, name = text.rpartition("=")
        if not sign or not header.strip() or not name.strip():
            raise InvalidInput(
                f"--column must look like 'HEADER=NAME', such as 'X=arm1_x_mm'; received {quoted(text)}"
            )
        columns[header.strip()] = name.strip()
    return columns


def named_constants(texts: Sequence[str]) -> dict[str, float]:
    """Numbers of the option `--constant`, such as `arm1_y_mm=0`.

    Raises:
        InvalidInput: A text has another form, or a name comes twice.
    Examples:
        >>> named_constants(["arm1_y_mm=0", "coil1_current_A=3"])
        {'arm1_y_mm': 0.0, 'coil1_current_A': 3.0}
    """
    constants: dict[str, float] = {}
    for text in texts:
        name, _, value = (part.strip() for part in text.partition("="))
        if not PLAIN.match(value) or name in constants or abs(float(value)) > LARGEST:
            raise InvalidInput(f"--constant must look like NAME=1.0, each name once; received {quoted(text)}")
        constants[name] = float(value)
    return constants
