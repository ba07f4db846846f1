"""Figures of a diagnosis as a notebook asks for them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from estimator.glance import Shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class Presented(Shown):
    """A diagnosis as a notebook shows it."""

    def plot_residuals(self, ax: Axes | None = None, extended: bool = True) -> Axes:
        """Residuals over the noise beside the normal density (`plots.residual_histogram`).

        Args:
            ax: Axes to draw into; a new figure by default.
            extended: With the causes that were found; False for the rig as described.
        Examples:
            >>> diagnosis.plot_residuals().figure.savefig("residuals.png")  # doctest: +SKIP
        """
        return self._shown.plot_residuals(self, ax, extended)

    def plot_budget(self) -> Figure:
        """Share of the error on unseen readings that each cause accounts for (`plots.error_budget`).

        Raises:
            InvalidInput: There is no budget, for nothing was found or no reading was kept out of the fits.
        """
        return self._shown.plot_budget(self)
