"""A report part by part: one that cannot be made costs no other."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

from estimator.diagnosis.result import DIAGNOSIS, Diagnosis

T = TypeVar("T")
_LOG = logging.getLogger(__name__)


def part_by_part(
    parts: Sequence[Callable[[Diagnosis], Iterable[T]]],
    diagnosis: Diagnosis,
    missing: Callable[[str], T] | None = None,
) -> list[T]:
    """What each part says of a diagnosis, one after another.

    Args:
        parts: Each makes some sentences, tables or pictures.
        diagnosis: Which they are about.
        missing: Makes what stands in the place of a part that failed from a sentence that says so; None leaves the place empty.
    """
    made: list[T] = []
    for part in parts:
        try:
            made += list(part(diagnosis))
        except Exception as error:  # any: a report of hours of work must not fail for a sentence
            name = part.__name__.strip("_").replace("_", " ")
            _LOG.exception("the part %r of a report could not be made", name)
            if missing is not None:
                words = f"{type(error).__name__} {error}"
                made.append(
                    missing(
                        f"The part {name!r} of this report could not be made, by a fault of coilcal ({words}); {DIAGNOSIS} is whole."
                    )
                )
    return made
