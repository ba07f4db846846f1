"""Which parameters matter: a full factorial, Sobol indices and the Fisher information of the readings to come.

The factorial is the paper's study (section 4.2, Table 1, Fig 8) in one batched prediction. It says what changes the field, not what a fit
can tell apart: parameters that change it alike form one direction, which only the Fisher information shows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.stats import qmc, sobol_indices

from estimator.derivatives import jacobian_of
from estimator.errors import InvalidInput
from estimator.model.measurement_model import MeasurementModel
from estimator.planning.planned import LEARNT
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

N_LEVELS = 7  # of every parameter in the paper's Table 1
FAR_APART = 10.0  # ratio of the worst known to the best known direction that is worth a sentence
Response = Callable[[Float[Tensor, "*batch parameter"]], Float[Tensor, "*batch"]]


@dataclass(frozen=True)
class Factorial:
    """Responses of every combination of levels.

    Attributes:
        names: Of the parameters, an axis of `response` each.
        levels: Values of each parameter, in SI.
        response: Of every combination, in tesla.
        label: What the response is, for axes of figures.
    """

    names: tuple[str, ...]
    levels: tuple[np.ndarray, ...]
    response: np.ndarray
    label: str = "rms field"

    def main_effect(self, name: str) -> np.ndarray:
        """Mean response at each level of one parameter."""
        return self._mean_over_all_but(name)

    def interaction(self, row: str, column: str) -> np.ndarray:
        """Mean response at each pair of levels."""
        mean = self._mean_over_all_but(row, column)
        return mean if self.names.index(row) < self.names.index(column) else mean.T

    def shares(self) -> dict[tuple[str, ...], float]:
        """Share of the variance that each parameter explains alone, and each pair beyond its two members.

        The levels are crossed, so the parts are orthogonal; what they leave belongs to interactions of three and more.
        """
        whole, centre = float(self.response.var()), float(self.response.mean())
        main = {name: self.main_effect(name) - centre for name in self.names}
        variances: dict[tuple[str, ...], float] = {(name,): float((e**2).mean()) for name, e in main.items()}
        for row, column in combinations(self.names, 2):
            beyond = self.interaction(row, column) - centre - main[row][:, None] - main[column][None, :]
            variances[row, column] = float((beyond**2).mean())
        return {key: part / whole for key, part in variances.items()}

    def _mean_over_all_but(self, *names: str) -> np.ndarray:
        axes = tuple(i for i, name in enumerate(self.names) if name not in names)
        return np.asarray(self.response.mean(axis=axes))


@dataclass(frozen=True)
class Sobol:
    """Variance-based sensitivity over the box that the levels span: of each parameter alone, and with all its interactions."""

    names: tuple[str, ...]
    first: np.ndarray
    total: np.ndarray


@dataclass(frozen=True)
class Information:
    """What readings with their noise will say about parameters, in units of the prior's standard deviation.

    Attributes:
        names: Of the parameters.
        prior_sd: Their prior widths, in SI.
        sd_by_direction: Standard deviation from the data alone along each eigenvector of the Fisher information, best known first.
        directions: The eigenvectors, as columns.
        alone_sd: Of each parameter if all others were known.
        together_sd: Of each parameter with all free and the priors in force.
    """

    names: tuple[str, ...]
    prior_sd: np.ndarray
    sd_by_direction: np.ndarray
    directions: np.ndarray
    alone_sd: np.ndarray
    together_sd: np.ndarray

    @property
    def n_determined(self) -> int:
        """Directions that the data know better than the prior."""
        return int((self.sd_by_direction < 1.0).sum())

    def worth_fitting(self) -> tuple[str, ...]:
        """Parameters whose width the readings at least halve, all being free."""
        return tuple(n for n, sd in zip(self.names, self.together_sd, strict=True) if sd < LEARNT)

    def words(self) -> str:
        """Which parameters are worth fitting, in a sentence or two."""
        worth, n = self.worth_fitting(), len(self.names)
        rest = [name for name in self.names if name not in worth]
        text = f"The readings determine {self.n_determined} of {n} directions better than the prior."
        if worth:
            text += f" Worth fitting: {', '.join(self._says(name) for name in worth)}."
        if rest:
            text += (
                f" Not by themselves: {', '.join(self._says(name) for name in rest)}; leave them free with their priors, or fix them "
                "and read the others as conditional on that."
            )
        ratio = self.sd_by_direction[-1] / self.sd_by_direction[0]
        if n > 1 and ratio > FAR_APART:
            weight = self.directions[:, -1]
            parts = [
                f"{weight[i]:+.2f} {self.names[i]}"
                for i in np.argsort(-np.abs(weight))
                if abs(weight[i]) > 0.1
            ]
            text += f" The least known combination ({', '.join(parts)}) is {ratio:.0f} times less certain than the best."
        return text

    def _says(self, name: str) -> str:
        i = self.names.index(name)
        return f"{name} (to {100.0 * min(self.together_sd[i], 1.0):.2g} % of its prior width)"


def levels_about(rig: Rig, names: Sequence[str], n_levels: int = N_LEVELS) -> dict[str, np.ndarray]:
    """Evenly spaced levels from one prior standard deviation below the nominal value to one above.

    Raises:
        InvalidInput: A parameter without a prior, which has no scale to vary it by.
    """
    nominal = rig.nominal_values()
    return {name: nominal[name] + _prior_sd(rig, name) * np.linspace(-1.0, 1.0, n_levels) for name in names}


def rms_field(rig: Rig, observations: Observations, names: Sequence[str]) -> Response:
    """Rms field over the readings in tesla as a function of some parameters; all others stay at their nominal values."""
    field_T = _predictions(rig, observations, names)
    return lambda values: field_T(values).square().sum(-1).mean(-1).sqrt()


def rms_change(rig: Rig, observations: Observations, names: Sequence[str]) -> Response:
    """Rms length of the change of the field from that of the nominal rig, in tesla; arguments as in `rms_field`."""
    field_T, nominal = _predictions(rig, observations, names), rig.nominal_values()
    reference_T = field_T(torch.tensor([nominal[name] for name in names], dtype=torch.float64))
    return lambda values: (field_T(values) - reference_T).square().sum(-1).mean(-1).sqrt()


def _predictions(
    rig: Rig, observations: Observations, names: Sequence[str]
) -> Callable[[Float[Tensor, "*batch parameter"]], Float[Tensor, "*batch reading 3"]]:
    """Predicted readings, (*batch, reading, 3), as a function of some parameters."""
    fixed = [parameter.name for parameter in rig.free if parameter.name not in names]
    coordinates, model = Coordinates(rig.with_fixed(fixed)), MeasurementModel.build(rig, observations)

    def field_T(values: Tensor) -> Tensor:
        vector = coordinates.vector(dict(zip(names, values.unbind(-1), strict=True)))
        with torch.no_grad():
            return model.predict(coordinates.values(vector))

    return field_T


def factorial(response: Response, levels: Mapping[str, np.ndarray], label: str = "rms field") -> Factorial:
    """All combinations of levels in one batch.

    References: Osinde et al., section 4.2: seven levels of four parameters, 2401 runs.
    """
    axes = [torch.from_numpy(np.asarray(values, dtype=float)) for values in levels.values()]
    runs = torch.cartesian_prod(*axes).reshape(-1, len(axes))
    response_T = response(runs).reshape([len(axis) for axis in axes])
    return Factorial(tuple(levels), tuple(axis.numpy() for axis in axes), response_T.numpy(), label)


def sobol(response: Response, levels: Mapping[str, np.ndarray], n: int = 512) -> Sobol:
    """Sobol indices over the box of the levels, all runs in one batch of n times (parameters + 2).

    Args:
        response: As for `factorial`.
        levels: Their ends bound the box.
        n: Points of the low-discrepancy sample, a power of 2.
    References: Saltelli et al., Comput. Phys. Commun. 181, 259 (2010), as in scipy.stats.sobol_indices.
    """
    d = len(levels)
    low, high = (np.array([end(values) for values in levels.values()]) for end in (np.min, np.max))
    both = qmc.Sobol(2 * d, scramble=False).random(n)
    a, b = (low + part * (high - low) for part in np.split(both, 2, axis=1))
    mixed = np.repeat(a[None], d, axis=0)
    for i in range(d):
        mixed[i, :, i] = b[:, i]
    values = response(torch.from_numpy(np.concatenate((a[None], b[None], mixed)))).numpy()
    runs: dict[Literal["f_A", "f_B", "f_AB"], np.ndarray] = {
        "f_A": values[:1],
        "f_B": values[1:2],
        "f_AB": values[2:, None],
    }
    indices = sobol_indices(func=runs, n=n)
    return Sobol(tuple(levels), indices.first_order.ravel(), indices.total_order.ravel())


def information(rig: Rig, observations: Observations, names: Sequence[str]) -> Information:
    """Fisher information of readings with the noise of their sensors at the rig's nominal values.

    Args:
        rig: With priors for the parameters; whole-numbered counts are taken as real.
        observations: Poses and currents; field values are not needed.
        names: Parameters that are free together; all others are known.
    Raises:
        InvalidInput: A parameter without a prior, or a sensor without noise.
    """
    fixed = [parameter.name for parameter in rig.free if parameter.name not in names]
    coordinates, model = Coordinates(rig.with_fixed(fixed)), MeasurementModel.build(rig, observations)
    nominal, prior_sd = rig.nominal_values(), np.array([_prior_sd(rig, name) for name in names])
    noise_T = torch.tensor([nominal[f"{sensor.name}.noise_T"] for sensor in rig.sensors]).double()
    if not bool((noise_T > 0.0).all()):
        raise InvalidInput(
            f"noise of every sensor must be > 0 to weigh readings; received {noise_T.tolist()} T"
        )
    centre, step = torch.tensor([nominal[name] for name in names]).double(), torch.from_numpy(prior_sd)

    def whitened(shift: Tensor) -> Tensor:
        vector = coordinates.vector(dict(zip(names, centre + step * shift, strict=True)))
        field_T = model.predict(coordinates.values(vector))
        return (field_T / noise_T[observations.sensor, None]).flatten()

    jacobian = jacobian_of(whitened, torch.zeros(len(names), dtype=torch.float64)).numpy()
    _, size, rows = np.linalg.svd(jacobian, full_matrices=False)
    fisher = jacobian.T @ jacobian
    together = np.linalg.inv(fisher + np.eye(len(names)))
    with np.errstate(divide="ignore"):
        sd, alone = 1.0 / size, 1.0 / np.sqrt(np.diag(fisher))
    return Information(tuple(names), prior_sd, sd, rows.T, alone, np.sqrt(np.diag(together)))


def _prior_sd(rig: Rig, name: str) -> float:
    parameter = rig.parameters.get(name)
    if parameter is None or parameter.prior is None or not math.isfinite(parameter.prior.sd):
        raise InvalidInput(f"sensitivity needs parameters with a prior; received {name!r} (rig {rig.name!r})")
    return parameter.prior.sd
