"""Every cause of a difference between simulation and measurement that coilcal knows, and the corrections for what has no known cause.

Names are stable. Packages outside this repository add causes of their own by the entry-point group `coilcal.effects`, programs by
`register_effect`; the contract is in `effects.base` and `effects.stages`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib import import_module
from importlib.metadata import entry_points
from types import ModuleType

from estimator.effects.base import Effect
from estimator.effects.circumstances import Extent
from estimator.effects.stages import CurrentEffect
from estimator.errors import InvalidInput, closest, quoted

# Modules of `causes` in the order in which a reading comes about, then those of `corrections`. Effects of one stage are applied in this
# order, and in that within a module.
CAUSES = (
    *("connections", "supply"),
    *("winding", "coil", "core", "formulas", "carried", "superconductor"),
    *("surroundings", "iron"),
    *("pose_record", "robot", "mount", "holder", "force", "misplaced"),
    *("sensor", "sensor_parts", "axes", "sensor_history"),
    *("record", "noise"),
)
CORRECTIONS = ("current", "fields", "guides", "stops", "response", "sensor")


def _declared(module: ModuleType) -> Iterator[Effect]:
    """Effects, and classes of effects that have a name, in the order of a module; what begins with `_` is its own."""
    for name, value in vars(module).items():
        if name.startswith("_"):
            continue
        if isinstance(value, Effect):
            yield value
        elif isinstance(value, type) and issubclass(value, Effect) and hasattr(value, "name"):
            yield value()


EFFECTS: dict[str, Effect] = {}
for _module in (*(f"causes.{name}" for name in CAUSES), *(f"corrections.{name}" for name in CORRECTIONS)):
    for _effect in _declared(import_module(f"{__name__}.{_module}")):
        EFFECTS.setdefault(_effect.name, _effect)  # a module may name those of modules before
ORDER = {name: i for i, name in enumerate(EFFECTS)}
ENTRY_POINTS = "coilcal.effects"
NAME = re.compile(r"[a-z][a-z0-9_]*")  # of causes, as rig files write them


def register_effect(effect: object) -> None:
    """Make a cause known to everything: simulation, diagnosis, rig files, prediction.

    It acts after those of the library that share its stage. Other processes do not know of it: what workers, the live view or the command
    line should know comes from a package with an entry point in the group `coilcal.effects`.

    Args:
        effect: Of one of the stages in `estimator.effects.stages`.
    Raises:
        InvalidInput: It is no effect of a stage, its declaration is incomplete, or its name is taken.
    Examples:
        >>> register_effect(EFFECTS["current_gain"])
        Traceback (most recent call last):
        estimator.errors.InvalidInput: effect must have a name of its own; received 'current_gain', which is taken
    """
    if not isinstance(effect, Effect) or type(effect).__mro__[1] is Effect:
        raise InvalidInput(
            f"effect must be an instance of a stage in estimator.effects.stages; received {effect!r}"
        )
    missing = [key for key in ("name", "kind", "words", "source") if not getattr(effect, key, None)]
    if missing:
        raise InvalidInput(
            f"effect must declare {' and '.join(missing)}; received {type(effect).__name__} without"
        )
    if not NAME.fullmatch(effect.name):
        raise InvalidInput(f"effect must be named by small letters, digits and _; received {effect.name!r}")
    if effect.name in EFFECTS:
        raise InvalidInput(f"effect must have a name of its own; received {effect.name!r}, which is taken")
    for quantity in effect.quantities(Extent()):
        suffix = quantity.unit.replace(" ", "_").replace("/", "_per_").replace("1_per_", "per_")
        if quantity.unit != "1" and not quantity.key.endswith(suffix):
            raise InvalidInput(
                f"quantity of {effect.name} must end in its unit {suffix}; received {quantity.key!r}"
            )
    EFFECTS[effect.name] = effect
    ORDER[effect.name] = len(ORDER)


def _register_installed() -> None:
    """Causes of installed packages."""
    for point in entry_points(group=ENTRY_POINTS):
        try:
            declared = point.load()
            register_effect(declared() if isinstance(declared, type) else declared)
        except Exception as error:
            raise InvalidInput(
                f"plug-in {point.name!r} of {ENTRY_POINTS} must load ({point.value}); received {type(error).__name__}: {error}"
            ) from error


_register_installed()

COUPLING = next(
    effect for effect in EFFECTS.values() if isinstance(effect, CurrentEffect) and effect.couples_coils
)
"""The cause by which one coil drives another, which a test of superposition asks for first."""


def closest_cause(name: str) -> str:
    """The cause that may have been meant, or where all stand, as the end of a sentence."""
    return closest(name, EFFECTS) or "; 'coilcal explain' lists them"


def effect_of(name: str) -> Effect:
    """The effect of that name.

    Raises:
        InvalidInput: There is none; the message names the closest.
    """
    if name not in EFFECTS:
        raise InvalidInput(
            f"cause must be one that coilcal knows; received {quoted(name)}{closest_cause(name)}"
        )
    return EFFECTS[name]
