"""What a notebook asks of a diagnosis: a glance at it and its figures. They are drawn above the result, so they are loaded by name."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from estimator.glance import Glance, Shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def _shown() -> Any:
    return import_module("estimator.diagnosis.shown")


class Presented(Shown):
    """A diagnosis as a notebook shows it."""

    def glance(self) -> Glance:
        """What is shown of it: what is wrong, the causes with their sizes, and the error budget."""
        glance: Glance = _shown().diagnosis_glance(self)
        return glance

    def plot_residuals(self, ax: Axes | None = None, extended: bool = True) -> Axes:
        """Residuals over the noise beside the normal density (`plots.residual_histogram`).

        Args:
            ax: Axes to draw into; a new figure by default.
            extended: With the causes that were found; False for the rig as described.
        Examples:
            >>> diagnosis.plot_residuals().figure.savefig("residuals.png")  # doctest: +SKIP
        """
        axes: Axes = _shown().plot_residuals(self, ax, extended)
        return axes

    def plot_budget(self) -> Figure:
        """Share of the error on unseen readings that each cause accounts for (`plots.error_budget`).

        Raises:
            InvalidInput: There is no budget, for nothing was found or no reading was kept out of the fits.
        """
        figure: Figure = _shown().plot_budget(self)
        return figure
