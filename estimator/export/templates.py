"""Templates of exported source code, which stand beside this file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jinja2

from estimator.tensors import Tensor

Filters = Mapping[str, Callable[..., Any]]  # how values are written in a language, by name


def template(name: str, filters: Filters) -> jinja2.Template:
    """A template in which every name must be given.

    Args:
        name: Of its file.
        filters: Besides `number`.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("estimator.export", "."),
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
    )
    environment.filters |= {"number": number, **filters}
    return environment.get_template(name)


def number(value: Tensor | float) -> str:
    """All digits of a number.

    Examples:
        >>> number(0.1)
        '0.1'
    """
    return repr(float(value))
