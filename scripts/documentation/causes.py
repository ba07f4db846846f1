"""Pages of the reference, one for each cause: from its declaration, what `coilcal explain` says, and what it does to a simulated session.

`make docs` runs it before the site is built.
"""

from __future__ import annotations

import argparse
import inspect
import json
import re
import textwrap
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

from click.testing import CliRunner
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.axes import Axes

from estimator.cli.main import main as coilcal
from estimator.effects import EFFECTS
from estimator.effects.base import Effect, Kind
from estimator.effects.circumstances import Extent
from estimator.effects.during import During
from estimator.effects.stages import CurrentEffect, MountEffect, NoiseEffect
from estimator.reporting.plots.style import COMPONENT, COMPONENT_MARKER, GREY, NOISE, figure, styled
from scripts.documentation.cause_patterns import MOST_ALIKE, NOISE_T, Pattern, grounds, pattern

GROUPS = {  # page: title and what a declaration says of itself; the first that fits is taken
    "of-noise": ("Scatter", lambda effect: isinstance(effect, NoiseEffect)),
    "of-the-current": ("Supplies and currents", lambda effect: isinstance(effect, CurrentEffect)),
    "of-places": ("Where bodies stand", lambda effect: isinstance(effect, MountEffect)),
    "of-the-coil": ("Coils and cores", lambda effect: effect.kind is Kind.COIL),
    "of-the-room": ("The room", lambda effect: effect.kind is Kind.ROOM),
    "of-movers": ("Arms and stages", lambda effect: effect.kind is Kind.MOVER),
    "of-sensors": ("Sensors", lambda effect: effect.kind is Kind.SENSOR),
    "of-the-record": ("What was written down", lambda effect: effect.kind is Kind.RECORD),
}
SHOWN = (
    "of-the-coil",
    "of-the-current",
    "of-places",
    "of-movers",
    "of-sensors",
    "of-the-room",
    "of-noise",
    "of-the-record",
)
# Methods of a declaration that say where and when it is asked, not what it does.
BOOKKEEPING = (
    "quantities",
    "places",
    "concerns",
    "starts",
    "unseen",
    "broken_rule",
    "is_itself",
    "extent_of",
    "beyond_the_moment",
)
DECLARATION = re.compile(r"\A@.*?^(?=def )", re.DOTALL | re.MULTILINE)  # what stands before a function
DOCSTRING = re.compile(r'^ +""".*?"""\n', re.DOTALL | re.MULTILINE)  # which the page says elsewhere
LARGE_T = 1e-3  # a field from which on it is told in millitesla
HIDDEN_SHARE = 0.2  # of the noise, below which nothing of a cause is left


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/reference/causes"))
    folder: Path = parser.parse_args().out
    (folder / "pictures").mkdir(parents=True, exist_ok=True)
    templates = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    templates.globals |= {"sentence": sentence, "prose": prose}
    said = {name: explained(name) for name in EFFECTS}
    shown = grounds()
    for name in library():
        found = pattern(name, shown)
        draw(found, folder / "pictures" / f"{name}.png")
        words = templates.get_template("cause.md.j2").render(**of_page(EFFECTS[name], said[name], found))
        (folder / f"{name}.md").write_text(words, encoding="utf-8")
    groups = grouped()
    corrections = [name for name, effect in EFFECTS.items() if effect.is_correction]
    of_all = {
        "said": said,
        "groups": groups,
        "titles": {page: title for page, (title, _) in GROUPS.items()},
        "corrections": corrections,
        "n": len(library()),
    }
    for page, template in (("index", "causes"), ("corrections", "corrections")):
        words = templates.get_template(f"{template}.md.j2").render(**of_all)
        (folder / f"{page}.md").write_text(words, encoding="utf-8")
    for page, names in groups.items():
        words = templates.get_template("group.md.j2").render(**of_all, title=GROUPS[page][0], names=names)
        (folder / f"{page}.md").write_text(words, encoding="utf-8")
    print(f"{len(library())} pages of causes written to {folder}")


def library() -> list[str]:
    """Causes that come with coilcal; corrections have a page together."""
    return [
        name
        for name, effect in EFFECTS.items()
        if not effect.is_correction and type(effect).__module__.startswith("estimator.")
    ]


def grouped() -> dict[str, list[str]]:
    """Names of causes by the page that lists them."""
    page_of = {
        name: next(page for page, (_, fits) in GROUPS.items() if fits(EFFECTS[name])) for name in library()
    }
    return {page: [name for name in library() if page_of[name] == page] for page in SHOWN}


def explained(name: str) -> dict[str, Any]:
    """What `coilcal explain NAME --json` prints."""
    result = CliRunner().invoke(coilcal, ["explain", name, "--json"], catch_exceptions=False)
    record: dict[str, Any] = json.loads(result.stdout)
    return record


def of_page(effect: Effect, said: dict[str, Any], found: Pattern) -> dict[str, Any]:
    """What the template of a page asks for."""
    left_T = None if found.left_T is None else float(abs(found.left_T).max())
    unit = "" if found.unit == "1" else f" {found.unit}"
    return {
        "name": effect.name,
        "effect": effect,
        "module": type(effect).__module__,
        "said": said,
        "formula": formula(effect),
        "shapes": {quantity.key for quantity in effect.quantities(Extent()) if quantity.is_shape},
        "visible": lambda key: f"{found.smallest[key]:.2g}" if key in found.smallest else "",
        "ground": found.ground.rig.name,
        "largest": in_words(float(abs(found.change_T).max())),
        "left": None if left_T is None else in_words(left_T),
        "hides": left_T is not None and left_T < HIDDEN_SHARE * NOISE_T,
        "size": f"`{found.key}` at {found.size:.3g}{unit}" if found.key else "it is there",
        "given": found.given,
        "alike": [(other, min(cosine, 0.999)) for other, cosine in found.alike.items()][:MOST_ALIKE],
    }


def in_words(field_T: float) -> str:
    """A field with its unit."""
    return f"{1e6 * field_T:.3g} microtesla" if field_T < LARGE_T else f"{1e3 * field_T:.3g} millitesla"


def formula(effect: Effect) -> str:
    """The functions of its stage, as the declaration has them; those of what is there meanwhile, for a part of a session."""
    own = [
        DOCSTRING.sub("", DECLARATION.sub("", textwrap.dedent(inspect.getsource(method))), count=1).rstrip()
        for name, method in vars(type(effect.base if isinstance(effect, During) else effect)).items()
        if inspect.isfunction(method) and not name.startswith("_") and name not in BOOKKEEPING
    ]
    return "\n\n".join(own)


def sentence(words: str) -> str:
    """With a capital and a full stop."""
    return f"{words[:1].upper()}{words[1:].rstrip('.')}."


def prose(docstring: str) -> str:
    """A docstring as Markdown: what stands indented is a block, the rest paragraphs; lists stay lists."""
    parts = []
    for part in docstring.split("\n\n"):
        if part.startswith("    "):
            parts.append(f"```text\n{part}\n```")
        else:
            parts.append(part if part.lstrip().startswith("- ") else " ".join(part.split()))
    return "\n\n".join(parts)


@styled
def draw(found: Pattern, file: Path) -> None:
    """What it does, and what is left of it."""
    shown = [(found.change_T, "what it does to the readings")]
    if found.left_T is not None:
        shown.append((found.left_T, "what a calibration leaves of it"))
    fig = figure(4.6 * len(shown), 2.9)
    panels = fig.subplots(1, len(shown), squeeze=False)[0]
    for ax, (change_T, title) in zip(panels, shown, strict=True):
        draw_change(ax, change_T, title)
    panels[-1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    fig.savefig(file, dpi=110)


def draw_change(ax: Axes, change_T: Any, title: str) -> None:
    unit, per_T = ("µT", 1e6) if abs(change_T).max() < LARGE_T else ("mT", 1e3)
    ax.axhspan(-per_T * NOISE_T, per_T * NOISE_T, color=NOISE, zorder=0)
    ax.axhline(0.0, color=GREY, linewidth=0.8)
    for axis, name in enumerate("xyz"):
        marker = {"color": COMPONENT[name], "marker": COMPONENT_MARKER[name], "markersize": 3.0}
        ax.plot(per_T * change_T[:, axis], linestyle="none", label=f"B{name}", **marker)
    ax.set(xlabel="reading", ylabel=f"change ({unit})", title=title)


if __name__ == "__main__":
    main()
