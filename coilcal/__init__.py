"""The public names of coilcal under the name of its distribution; `estimator` and `drivers` hold the code and keep their names.

Other distributions may have packages called `estimator` or `drivers` too, and pip lets the last one that is installed replace the files
of the others. That is found out here, before anything runs.

Examples:
    >>> import coilcal
    >>> coilcal.load_rig("configs/paper_simulation.yaml").name
    'paper, simulated coil'
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from estimator import *  # noqa: F403

PACKAGES = ("estimator", "drivers")


def check_packages() -> None:
    """Make sure that `estimator` and `drivers` are those of coilcal.

    Raises:
        ImportError: One of them is another distribution's.
    """
    for name in PACKAGES:
        package = import_module(name)
        if getattr(package, "DISTRIBUTION", None) != "coilcal":
            raise ImportError(
                f"package {name!r} must be that of coilcal; {package.__file__ or package.__path__} is of another distribution: install "
                "coilcal in a virtual environment of its own, and run it in a folder without a package of this name"
            )


def __getattr__(name: str) -> Any:
    """A public name of `estimator`, loaded when it is first used (PEP 562)."""
    if name.startswith("__") and name != "__all__":
        raise AttributeError(f"module 'coilcal' has no attribute {name!r}")
    check_packages()
    return getattr(import_module("estimator"), name)


def __dir__() -> list[str]:
    """Public names, loaded or not."""
    check_packages()
    return list(import_module("estimator").__all__)
