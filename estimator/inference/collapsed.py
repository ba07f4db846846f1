"""Amplitudes that the readings are linear in, integrated out of a posterior in closed form.

The readings are normal about predictions that are linear in the amplitudes of coils without a winding, and so are the priors of these. For
any values of all other parameters the amplitudes are then normal given the readings, and their integral has a closed form. What is
sampled is the density of the others alone, of which there are few; amplitudes are drawn afterwards.

References: Bishop, Pattern Recognition and Machine Learning (2006), section 3.3 (Bayesian linear regression) and eq 3.86 (its evidence).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimator.derivatives import value_and_jacobian
from estimator.devices import numpy_of
from estimator.effects.stages import NoiseEffect
from estimator.effects.use import uses_of
from estimator.field.node_sum import SumMode
from estimator.inference.density import Density
from estimator.inference.levenberg_marquardt import prior_gradient_and_precision
from estimator.inference.likelihood import LogPosterior
from estimator.inference.positive_definite import inverse
from estimator.rig.coordinates import Coordinates, Values
from estimator.rig.parameters import Normal, Tie
from estimator.rig.rig import Rig

LINEAR_TO = 1e-9  # of the largest predicted component: rounding of sums over thousands of terms
MOST_NUMBERS = 20_000_000  # of a design matrix at once, to bound memory


class Conditional(NamedTuple):
    """Amplitudes given the rest, in standard deviations of their priors from the centres of these.

    Attributes:
        mean: Most probable amplitudes.
        precision: Of their normal distribution.
    """

    mean: Float[Tensor, "*batch amplitude"]
    precision: Float[Tensor, "*batch amplitude amplitude"]


@dataclass(frozen=True)
class _Sums:
    """Design matrix and residuals of readings, summed over the components of each sensor, with the amplitudes at `_about`.

    Attributes:
        gram: D^T D, with D the change of the components per prior standard deviation of each amplitude, in T.
        score: D^T r, with r the residuals in T.
        square: r^T r.
        n: Number of components.
    """

    gram: Float[Tensor, "sensor amplitude amplitude"]
    score: Float[Tensor, "sensor amplitude"]
    square: Float[Tensor, " sensor"]
    n: Float[Tensor, " sensor"]


class _Principal(NamedTuple):
    """Combinations of amplitudes that each move a combination of the readings of their own: singular vectors of the design matrix.

    Attributes:
        vectors: Orthogonal combinations of amplitudes, in columns.
        size: By how much each moves its combination of the readings, in T.
        measured: That combination of the readings less its prediction with all amplitudes at their centres, in T.
        left: Square of what no amplitude moves, in T^2.
    """

    vectors: Float[Tensor, "amplitude direction"]
    size: Float[Tensor, " direction"]
    measured: Float[Tensor, " direction"]
    left: Float[Tensor, ""]


class CollapsedPosterior(Density):
    """Log posterior density of all parameters but the amplitudes of coils without a winding, batched over walkers.

    Attributes:
        full: Density of all parameters.
        amplitudes: Names of those that are integrated out.
        coordinates: Of the others; loop counts are real numbers.
    """

    def __init__(self, full: LogPosterior) -> None:
        self.full = full
        rig = full.coordinates.rig
        self.amplitudes = free_amplitudes(rig)
        self.coordinates = Coordinates(rig.with_fixed(self.amplitudes)).on(full.coordinates.device)
        priors = [rig.parameters[name].prior for name in self.amplitudes]
        self._centre = full.measured_T.new_tensor([p.centre for p in priors if p])
        self._sd = full.measured_T.new_tensor([p.sd for p in priors if p])
        self._following = _following(rig, self.amplitudes)
        noises = {f"{sensor.name}.noise_T" for sensor in rig.sensors}
        has_normal_noise = not uses_of(rig, NoiseEffect)
        self._is_only_noise = has_normal_noise and noises.issuperset(self.coordinates.names)

    def log_likelihood(self, vector: Float[Tensor, "*batch coordinate"]) -> Float[Tensor, "*batch"]:
        """Log probability density of the measured components, averaged over the amplitudes' priors."""
        batch = vector.shape[:-1]
        vector = vector.reshape(batch.numel(), vector.shape[-1])
        constant = 0.5 * math.log(2.0 * math.pi) * len(self.full.measured_T)
        if self._is_only_noise:
            sums, sigma_T = self._sums, self._sigma_T(vector)
            if len(sums.n) == 1:
                # Squares alone: differences of larger sums would turn negative where the noise is below their rounding.
                _, size, measured, left = self._principal
                variance = sigma_T**2
                misfit = measured**2 / (variance + size**2)
                squares = left / variance[:, 0] + (misfit + torch.log1p(size**2 / variance)).sum(-1)
                return (-0.5 * squares - (sums.n * torch.log(sigma_T)).sum(-1) - constant).view(batch)
            constant += 0.5 * float(self._about.square().sum())
            total = (
                -0.5 * (sums.square / sigma_T**2).sum(-1) - (sums.n * torch.log(sigma_T)).sum(-1) - constant
            )
            return (total + self._gain(*self._normal_equations(vector))).view(batch)
        terms = []
        for rows in vector.split(self._n_rows_at_once):
            design, residual, log_sigma = self._whitened(rows)
            gain = self._gain(*self._least_squares(design, residual))
            squares = residual.square().sum(-1) + self._about.square().sum()
            terms.append(gain - 0.5 * squares - log_sigma.sum(-1) - constant)
        return torch.cat(terms).view(batch)

    def given(self, vector: Float[Tensor, "*row coordinate"]) -> Conditional:
        """The amplitudes given all else, for each set of values."""
        if self._is_only_noise:
            precision, score = self._normal_equations(vector)
            if len(self._sums.n) == 1:
                vectors, size, measured, _ = self._principal
                mean = size * measured / (self._sigma_T(vector) ** 2 + size**2)
                return Conditional(mean @ vectors.mT, precision)
        else:
            design, residual, _ = self._whitened(vector)
            precision, score = self._least_squares(design, residual)
        return Conditional(self._about + _solved(precision, score), precision)

    def values(self, vector: Float[Tensor, " coordinate"]) -> dict[str, Tensor]:
        """Every parameter of the rig, with the most probable amplitudes."""
        amplitudes = self._centre + self._sd * self.given(vector).mean
        return self._with(self.coordinates.values(vector), amplitudes)

    def determined(self, vector: Float[Tensor, " coordinate"]) -> dict[str, tuple[int, int]]:
        """Number of free amplitudes of each coil, and of their combinations that the readings tell better than the priors."""
        precision = self.given(vector).precision
        counts = {}
        for coil in self.full.coordinates.rig.unwound:
            own = [i for i, name in enumerate(self.amplitudes) if name.startswith(f"{coil.name}.")]
            if own:
                data_over_prior = torch.linalg.eigvalsh(precision[own][:, own]) - 1.0
                counts[coil.name] = (len(own), int((data_over_prior > 1.0).sum()))
        return counts

    def curvature(self, vector: Float[Tensor, " coordinate"]) -> tuple[Tensor, Tensor]:
        """Negative Hessian of the log density, Gauss-Newton for the data, and the data's part of it.

        With the amplitudes at their most probable values; what these follow is taken off (Schur complement).
        """
        values = self.values(vector)
        best = torch.stack([values[name] for name in self.amplitudes])
        model = self.full.model.with_mode(SumMode.FIRST_ORDER)

        def moved(step: Tensor) -> Tensor:
            field_T = model.predict(self._with(self.coordinates.values(vector + step), best))
            sigma_T = self.full.component_sigma_T(self._with_centre(vector + step))
            return torch.stack((self.full.measured_components(field_T), torch.log(sigma_T)))

        (predicted_T, log_sigma), (slope_T, log_sigma_slope) = value_and_jacobian(
            moved, torch.zeros_like(vector)
        )
        sigma_T = torch.exp(log_sigma)
        slope = slope_T / sigma_T[:, None]
        mean_chi2 = ((self.full.measured_T - predicted_T) / sigma_T).square().mean().clamp(min=0.25)
        information = slope.mT @ slope + 2.0 * mean_chi2 * log_sigma_slope.mT @ log_sigma_slope
        if bool((slope != 0.0).any()):
            design = self._whitened(vector)[0]
            along = design.mT @ slope
            followed = torch.linalg.cholesky(_unit_plus(design.mT @ design))
            off = torch.linalg.solve_triangular(followed, along, upper=False)
            information = information - off.mT @ off
        _, prior = prior_gradient_and_precision(self.coordinates, vector[None])
        return information + prior[0], information

    def drawn(
        self, chain: Float[np.ndarray, "step walker coordinate"], seed: int
    ) -> dict[str, Float[np.ndarray, "step walker"]]:
        """One draw of the amplitudes for each draw of all else.

        Args:
            chain: Draws of the coordinates.
            seed: Of the draws.
        """
        steps, walkers = chain.shape[:2]
        rows = torch.from_numpy(chain.reshape(steps * walkers, -1)).to(self._sd)
        n = len(self.amplitudes)
        generator = torch.Generator().manual_seed(seed)
        normal = torch.randn(len(rows), n, generator=generator, dtype=torch.float64).to(self._sd)
        if self._is_only_noise and len(self._sums.n) == 1:
            vectors, size, measured, _ = self._principal
            variance = self._sigma_T(rows) ** 2
            mean = size * measured / (variance + size**2)
            along = normal @ vectors  # combinations that move no reading keep their prior
            standard = normal + (mean + along / (1.0 + size**2 / variance).sqrt() - along) @ vectors.mT
        else:
            distinct, row_of = rows[:1], rows.new_zeros(len(rows), dtype=torch.int64)
            if rows.shape[1]:  # walkers stay where they are now and then
                distinct, row_of = torch.unique(rows, dim=0, return_inverse=True)
            standard = torch.empty_like(normal)
            for part in torch.arange(len(distinct), device=rows.device).split(self._n_rows_at_once):
                given = self.given(distinct[part])
                own = ((row_of >= part[0]) & (row_of <= part[-1])).nonzero().flatten()
                which = row_of[own] - part[0]
                root = torch.linalg.cholesky(given.precision)[which]
                off = torch.linalg.solve_triangular(root.mT, normal[own][..., None], upper=True)[..., 0]
                standard[own] = given.mean[which] + off
        drawn = numpy_of(self._centre + self._sd * standard).reshape(steps, walkers, n)
        return {name: drawn[:, :, i] for i, name in enumerate(self.amplitudes)}

    @cached_property
    def is_linear(self) -> bool:
        """Whether the predictions are linear in the amplitudes, and readings scatter normally about them."""
        rig = self.full.coordinates.rig
        if any(use.effect.is_contaminating for use in uses_of(rig, NoiseEffect)):
            return False
        values = self.coordinates.values(self.coordinates.start())
        n = len(self.amplitudes)
        steps = torch.randn(2, n, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        steps = steps.to(self._sd)
        each = torch.cat((steps.new_zeros(1, n), steps, steps.sum(0, keepdim=True)))
        with torch.no_grad():
            none_T, one_T, other_T, both_T = self._predicted(
                values, self._centre + self._sd * each, torch.Size()
            )
        misfit_T = (both_T - one_T - other_T + none_T).abs().max()
        return bool(misfit_T <= LINEAR_TO * both_T.abs().max())

    @cached_property
    def _about(self) -> Float[Tensor, " amplitude"]:
        """Amplitudes about which squares are taken, in the units of `Conditional`: those of the nominal values.

        About zero the squares of readings a million times their noise would leave no digit for differences of log densities.
        """
        design_T, residual_T = self.at_start
        with torch.no_grad():
            sigma_T = self.full.component_sigma_T(self._with_centre(self.coordinates.start()))
        design = design_T / sigma_T[:, None]
        return _solved(_unit_plus(design.mT @ design), design.mT @ (residual_T / sigma_T))

    @cached_property
    def at_start(self) -> tuple[Tensor, Tensor]:
        """Design matrix and residuals of `_design`, with all else at the nominal values."""
        with torch.no_grad():
            return self._design(self.coordinates.start())

    @cached_property
    def _sums(self) -> _Sums:
        """Sums over the readings, which stay the same where nothing but the noise is free."""
        design_T, residual_T = self.at_start
        residual_T = residual_T - design_T @ self._about
        own = [self.full.sensor == i for i in range(len(self.full.n_by_sensor))]
        return _Sums(
            torch.stack([design_T[rows].mT @ design_T[rows] for rows in own]),
            torch.stack([design_T[rows].mT @ residual_T[rows] for rows in own]),
            torch.stack([residual_T[rows].square().sum() for rows in own]),
            self.full.n_by_sensor,
        )

    @cached_property
    def _principal(self) -> _Principal:
        """Principal combinations of amplitudes at the readings of a single sensor.

        Not by the matrix of `_sums`, whose small eigenvalues are rounding.
        """
        design_T, residual_T = self.at_start
        combinations, size, vectors = torch.linalg.svd(design_T, full_matrices=False)
        measured_T = combinations.mT @ residual_T
        left_T = residual_T - combinations @ measured_T
        return _Principal(vectors.mT, size, measured_T, left_T.square().sum())

    def _normal_equations(self, vector: Tensor) -> tuple[Tensor, Tensor]:
        """Precision of the amplitudes and right-hand side of their normal equations, where only the noise is free."""
        per_variance = self._sigma_T(vector) ** -2
        gram = torch.einsum("...s,sij->...ij", per_variance, self._sums.gram)
        return _unit_plus(gram), per_variance @ self._sums.score - self._about

    def _least_squares(self, design: Tensor, residual: Tensor) -> tuple[Tensor, Tensor]:
        """Precision of the amplitudes and right-hand side of their normal equations, from whitened design matrices and residuals."""
        score = (design.mT @ residual[..., None])[..., 0]
        return _unit_plus(design.mT @ design), score - self._about

    def _gain(self, precision: Tensor, score: Tensor) -> Tensor:
        """Addition to the log density at `_about` by the spread of the amplitudes."""
        root = torch.linalg.cholesky(precision)
        off = torch.linalg.solve_triangular(root, score[..., None], upper=False)[..., 0]
        log_determinant = 2.0 * torch.log(torch.diagonal(root, dim1=-2, dim2=-1)).sum(-1)
        return 0.5 * (off.square().sum(-1) - log_determinant)

    def _sigma_T(self, vector: Tensor) -> Float[Tensor, "*row sensor"]:
        return self.full.sensor_sigma_T(self.coordinates.values(vector), vector.shape[:-1])

    @property
    def _n_rows_at_once(self) -> int:
        """Rows whose design matrices are held together."""
        return max(1, MOST_NUMBERS // (4 * len(self.full.measured_T) * len(self.amplitudes)))

    def _whitened(self, vector: Float[Tensor, "*row coordinate"]) -> tuple[Tensor, Tensor, Tensor]:
        """Design matrices and residuals about `_about` in units of the noise, and the logarithm of the noise, by component."""
        with torch.no_grad():
            design_T, residual_T = self._design(vector)
            sigma_T = self.full.component_sigma_T(self._with_centre(vector))
        residual_T = residual_T - design_T @ self._about
        return design_T / sigma_T[..., None], residual_T / sigma_T, torch.log(sigma_T)

    def _design(
        self, vector: Float[Tensor, "*row coordinate"]
    ) -> tuple[Float[Tensor, "*row component amplitude"], Float[Tensor, "*row component"]]:
        """Change of the components per prior standard deviation of each amplitude, and the residuals at the centre, in T."""
        values = self.coordinates.values(vector[..., None, :])
        centre_T = self._predicted(values, self._centre[None], vector.shape[:-1])
        columns = []
        n_at_once = max(1, MOST_NUMBERS // (4 * centre_T.numel()))
        for each in self._sd.diag().split(n_at_once):
            columns.append(self._predicted(values, self._centre + each, vector.shape[:-1]) - centre_T)
        return torch.cat(columns, dim=-2).mT.contiguous(), self.full.measured_T - centre_T[..., 0, :]

    def _predicted(
        self, values: Values, amplitudes: Float[Tensor, "set amplitude"], rows: torch.Size
    ) -> Float[Tensor, "*row set component"]:
        """Measured components as predicted with sets of amplitudes, for rows of all else; values have an axis for the sets."""
        field_T = self.full.model.predict(self._with(values, amplitudes))
        predicted_T = self.full.measured_components(field_T)
        return predicted_T.expand(*rows, len(amplitudes), len(self.full.measured_T))

    def _with(self, values: Values, amplitudes: Float[Tensor, "*row amplitude"]) -> dict[str, Tensor]:
        """Values of a rig with other amplitudes, and with what is tied to them."""
        there = {**values, **dict(zip(self.amplitudes, amplitudes.unbind(-1), strict=True))}
        for name, tie in self._following.items():
            there[name] = tie.factor * there[tie.to]
        return there

    def _with_centre(self, vector: Tensor) -> Tensor:
        """Coordinates of the full density, with amplitudes at the centre of their priors."""
        own = [self.full.coordinates.names.index(name) for name in self.coordinates.names]
        there = self._at_centre.expand(*vector.shape[:-1], -1).clone()
        there[..., own] = vector
        return there

    @cached_property
    def _at_centre(self) -> Float[Tensor, " coordinate"]:
        """Coordinates of the full density at the nominal values, with amplitudes at the centre of their priors."""
        return self.full.coordinates.vector(dict(zip(self.amplitudes, self._centre, strict=True)))


def free_amplitudes(rig: Rig) -> tuple[str, ...]:
    """Free amplitudes of the rig's coils without a winding, with normal priors."""
    names = (name for coil in rig.unwound for own in coil.amplitudes.values() for name in own)
    return tuple(name for name in names if isinstance(rig.parameters[name].prior, Normal))


def _following(rig: Rig, amplitudes: tuple[str, ...]) -> dict[str, Tie]:
    """Ties to amplitudes, and to what is tied to them, in an order in which they can be followed."""
    following: dict[str, Tie] = {}
    for _ in rig.parameters:
        more = {
            name: p.tie
            for name, p in rig.parameters.items()
            if p.tie and name not in following and (p.tie.to in amplitudes or p.tie.to in following)
        }
        if not more:
            break
        following |= more
    return following


def _unit_plus(gram: Tensor) -> Tensor:
    """The prior's precision, which is 1 in these units, added."""
    return gram + torch.eye(gram.shape[-1], dtype=gram.dtype, device=gram.device)


def _solved(precision: Tensor, score: Tensor) -> Tensor:
    return (inverse(precision) @ score[..., None])[..., 0]
