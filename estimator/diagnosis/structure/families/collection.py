"""Families of flexible curves: columns that depend on one covariate, and their collection for one fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis.fitting import Fit
from estimator.effects.circumstances import Circumstances


@dataclass(frozen=True)
class Family:
    """Columns that depend on one covariate.

    Attributes:
        name: What they depend on, in words; families with the same name are alternatives.
        columns: Whitened; the mean over components of their summed squares is 1.
        detail: What tells it from the other alternatives, such as a period.
    """

    name: str
    columns: Float[Tensor, "component column"]
    detail: str = ""

    @classmethod
    def of(cls, name: str, whitened: Float[Tensor, "component column"], detail: str = "") -> Family:
        """The family of columns given at any common scale."""
        rms = torch.linalg.vector_norm(whitened) / whitened.shape[0] ** 0.5
        return cls(name, whitened / rms.clamp(min=1e-300), detail)

    def weighed(self, weight: Float[Tensor, " component"]) -> Family:
        """The family with each component's weight multiplied; amplitudes stay in units of the noise."""
        return Family.of(self.name, self.columns * weight[:, None], self.detail)

    @property
    def words(self) -> str:
        """Name and detail."""
        return f"{self.name}, {self.detail}" if self.detail else self.name


class Collection:
    """Collects families for one fit; columns that vanish are left out.

    Attributes:
        fit: The fit.
        predicted_T: Its predictions, in the sensor frame.
        field: The same over the largest component.
        axes: The three directions of the sensor at every reading.
        along_field: One column per axis, proportional to the component along it, as wrong gains are.
    """

    def __init__(self, fit: Fit) -> None:
        self.fit = fit
        self.families: list[Family] = []
        circumstances = fit.posterior.model.circumstances
        with torch.no_grad():
            self.predicted_T = fit.posterior.model.predict(fit.values).expand(len(circumstances), 3)
        self.field = self.predicted_T / self.predicted_T.abs().max().clamp(min=1e-12)
        self.axes = torch.eye(3).to(self.field).expand(len(circumstances), 3, 3)
        self.along_field = torch.diag_embed(self.field)

    def add(
        self,
        name: str,
        smooth: Float[Tensor, "reading order"],
        vectors: Float[Tensor, "reading 3 direction"],
        detail: str = "",
    ) -> None:
        """Add the products of smooth functions and vectors."""
        self.add_fields(name, torch.einsum("rk,rcv->rkvc", smooth, vectors).flatten(1, 2), detail)

    def add_fields(self, name: str, fields: Float[Tensor, "reading column 3"], detail: str = "") -> None:
        """Add columns given by reading and component."""
        self._add(name, fields.movedim(1, 0)[None], (detail,))

    def add_alike(
        self,
        name: str,
        smooth: Float[Tensor, "family reading order"],
        vectors: Float[Tensor, "reading 3 direction"],
        details: Sequence[str],
    ) -> None:
        """Add several families of one name at once, each the products of its smooth functions and the vectors."""
        self._add(name, torch.einsum("frk,rcv->fkvrc", smooth, vectors).flatten(1, 2), details)

    def _add(
        self, name: str, fields: Float[Tensor, "family column reading 3"], details: Sequence[str]
    ) -> None:
        columns = self.fit.posterior.measured_components(fields) * self.fit.whitening_per_T
        square = columns.square().sum(-1)
        norm = (square.sum(1) / columns.shape[-1]).sqrt().clamp(min=1e-300)
        is_nonzero = square.sqrt() > 1e-9 * norm[:, None] * columns.shape[-1] ** 0.5
        scaled = columns / norm[:, None, None]
        for family, is_kept, detail in zip(scaled, is_nonzero, details, strict=True):
            if bool(is_kept.all()):
                self.families.append(Family(name, family.T, detail))
            elif bool(is_kept.any()):
                self.families.append(Family.of(name, family[is_kept].T, detail))


def by_sensor(circumstances: Circumstances) -> list[tuple[str, Float[Tensor, " reading"]]]:
    """Names of the sensors that were read, each with 1 at its own readings and 0 at others."""
    seen = [(circumstances.sensor == i).to(torch.float64) for i in range(len(circumstances.rig.sensors))]
    named = zip((sensor.name for sensor in circumstances.rig.sensors), seen, strict=True)
    return [(name, its) for name, its in named if bool(its.any())]


def subsets(circumstances: Circumstances) -> list[tuple[str, Float[Tensor, " reading"]]]:
    """All readings, without a name, and those of each sensor where the rig has several."""
    everything = ("", torch.ones_like(circumstances.hours))
    return [everything, *(by_sensor(circumstances) if len(circumstances.rig.sensors) > 1 else [])]
