"""Templates of exported source code, which stand beside this file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jinja2
from jaxtyping import Float

from estimator.export.labels import plain_words
from estimator.export.magnet import Magnet
from estimator.export.plain_model import PlainCoil, PlainModel
from estimator.field.quadrature import arcs_of
from estimator.field.sided import SidedWinding
from estimator.field.winding_shape import DEFAULT_TOLERANCE
from estimator.field.zones import ZONES_PER_OCTAVE
from estimator.tensors import Tensor, torch

Filters = Mapping[str, Callable[..., Any]]  # how values are written in a language, by name


def template(name: str, filters: Filters) -> jinja2.Template:
    """A template in which every name must be given.

    Args:
        name: Of its file.
        filters: Besides those that every language needs.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("estimator.export", "."),
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
    )
    environment.filters |= {"number": number, "is_rounded": _is_rounded, "arc": _first_arc, **filters}
    return environment.get_template(name)


def source_code(magnet: Magnet, model: PlainModel, file: str, filters: Filters, **own: Any) -> str:
    """Source code of a magnet by a template, which gets the numbers and words that every language asks for.

    Args:
        magnet: What is exported.
        model: Its numbers.
        file: The template.
        filters: Besides those that every language needs.
        own: What this language asks for besides.
    """
    sided = any(isinstance(coil.winding, SidedWinding) for coil in model.coils)
    has_leads = any(coil.leads for coil in model.coils)
    return template(file, filters).render(
        model=model,
        title=plain_words(model.name),
        regions=magnet.regions,
        origin=magnet.origin,
        coil_names=", ".join(coil.name for coil in model.coils),
        mover_names=", ".join(mover.name for mover in model.movers) or "none",
        sided=sided,
        has_leads=has_leads,
        wires=sided or has_leads,
        tolerance=f"{DEFAULT_TOLERANCE:g}",
        zones_per_octave=ZONES_PER_OCTAVE,
        **own,
    )


def number(value: Tensor | float) -> str:
    """All digits of a number.

    Examples:
        >>> number(0.1)
        '0.1'
    """
    return repr(float(value))


def _is_rounded(coil: PlainCoil) -> bool:
    """Whether a coil has corners that are arcs."""
    return isinstance(coil.winding, SidedWinding) and coil.winding.is_rounded


def _first_arc(n: int) -> Float[Tensor, "point 3"]:
    """Cosine, sine and weight of the points of the arc in the first quarter."""
    return torch.from_numpy(arcs_of(n)[:n, :3])
