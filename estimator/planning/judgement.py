"""What readings say of goals: half-widths by the fit, widened by what readings contradict and by what causes may do unseen.

A fit whose noise is free takes what it cannot follow for noise, and its intervals shrink with the root of the number of readings although
the rest stays. Stops that are visited again show the noise alone. What the fit leaves beyond it, of its own readings or of held-out ones,
does not average out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from scipy.special import fdtrc, ndtri
from torch import Tensor

from estimator.planning.information import Expected, widths_of
from estimator.planning.so_far import Products, SoFar
from estimator.planning.splitting import Split
from estimator.planning.unseen import SURE, Unseen
from estimator.store.growing import observations_of

# Standard deviations of a normal number that is as rare, from which on intervals widen. Chance exceeds it at 0.1 % of the looks, and there
# is one after each stop. With 1 %, a rig without flaw looked contradicted for 100 stops and needed three times as many as others.
CLEAR_SD = 3.09
SMALLEST = 1e-300  # of a probability
FLOOR_GROWTH = 4.0  # so many times the stops tell what more of them would bring


@dataclass(frozen=True)
class Misfit:
    """What readings show beyond noise.

    Attributes:
        rest_T: Root mean square of it, in held-out readings or in those of the fit; 0 where chance explains both.
        noise_T: Root mean square of the noise, as repeated stops show it; NaN without any.
        n_held_out: Number of held-out stops.
        n_again: Number of visits beyond the first one of their stop.
        distance_sd: How surprising the larger of both is by an F-test against the noise, in standard deviations of a normal number.
        n_grown: How many times the readings so far are meant.
    """

    rest_T: float
    noise_T: float
    n_held_out: int
    n_again: int
    distance_sd: float = 0.0
    n_grown: float = 1.0

    def factor(self, n_fitted: int, n_unknown: int) -> float:
        """How much wider intervals are than those of noise alone.

        Noise leaves predictions a mean variance of noise^2 times unknowns over components; the rest adds its own square.

        Args:
            n_fitted: Readings of the fit so far.
            n_unknown: Free parameters.

        Examples:
            >>> Misfit(1e-6, 1e-6, 4, 4).factor(100, 3)
            10.05
        """
        if not self.rest_T > 0.0:
            return 1.0
        return math.sqrt(1.0 + 3 * self.n_grown * n_fitted / n_unknown * (self.rest_T / self.noise_T) ** 2)


@dataclass(frozen=True)
class Judged:
    """What the readings so far say of the goals.

    Attributes:
        widths: Half-width of the 90 % interval of each goal over its target, widened by what the readings contradict and by what causes
            may do unseen.
        later: The same, were there four times as many stops.
        misfit: What the readings contradict.
        cause: The quantity of an ordinary cause that widens most, with the size that the readings give it; empty without goals or causes.
        is_sure: Whether it is there for certain.
        is_most: Whether it widens the least known goal more than the fit does.
        stated: Causes that not even all stops could exclude, taken as the rig file states them.
        expected: The linearised model with that quantity, given the readings.
        n_unknown: Parameters of the fit.
        split: Causes that explain the readings equally well, where further stops would tell them apart.
    """

    widths: Float[Tensor, " goal"]
    later: Float[Tensor, " goal"]
    misfit: Misfit
    cause: str
    is_sure: bool
    is_most: bool
    stated: tuple[str, ...]
    expected: Expected
    n_unknown: int
    split: Split | None

    @property
    def is_reached(self) -> bool:
        """Whether every goal is."""
        return bool((self.widths <= 1.0).all())


def judge(so_far: SoFar) -> Judged:
    """Say what the readings so far say of the goals."""
    products, model, own = so_far.products(), so_far.model, so_far.own
    prior = products.prior[own][:, own]
    precision = prior + products.information[own][:, own]
    n_unknown = len(precision)
    n_followed = max(0.0, n_unknown - float(torch.trace(torch.linalg.solve(precision, prior))))
    misfit = misfit_of(so_far, products, torch.linalg.inv(precision), n_followed)
    noise, widest = _noise_factor(so_far, n_followed), model.every.widest

    def unseen_by(wanted: Sequence[Tensor]) -> Unseen:
        unseen = Unseen.of(products.information, products.score, products.prior, wanted, own, so_far.is_usual)
        return unseen.among(model.is_asked)

    def variances(wanted: Sequence[Tensor], unseen: Unseen, growth: float = 1.0) -> tuple[Tensor, Tensor]:
        grown = (prior + growth * (precision - prior)).expand(len(wanted[0]) if wanted else 1, -1, -1)
        by_fit = widths_of(wanted, widest, grown).median(-1).values.square()
        by_causes = unseen.variances(unseen.mean_square(growth), widest)
        return by_fit, by_causes.amax(-1) if by_causes.shape[-1] else torch.zeros_like(by_fit)

    def widths(wanted: Sequence[Tensor], unseen: Unseen, growth: float = 1.0) -> Tensor:
        by_fit, by_cause = variances(wanted, unseen, growth)
        factor = replace(misfit, n_grown=growth).factor(so_far.n_fitted, n_unknown)
        return noise * torch.maximum(factor**2 * by_fit, by_fit + by_cause).sqrt()

    wanted, unseen = list(model.alone.wanted), unseen_by([rows[0] for rows in model.every.wanted])
    now = widths(wanted, unseen)
    if so_far.entries and bool((now <= 1.0).all()):  # promised only by the rows at the estimate
        here = so_far.wanted()
        wanted, unseen = [rows[None, :, own] for rows in here], unseen_by(here)
        now = widths(wanted, unseen)
    leading = _leading(unseen, widest, now)
    by_fit, by_cause = variances(wanted, unseen)
    cause, is_sure = _words(so_far, unseen, leading)
    stated = dict.fromkeys(name.rpartition(".")[0] for name in _names(so_far, ~model.is_asked))
    return Judged(
        now,
        widths(wanted, unseen, FLOOR_GROWTH),
        misfit,
        cause,
        is_sure,
        bool((by_cause > by_fit)[int(now.argmax())]),
        tuple(stated),
        _given(so_far, products, unseen, leading),
        n_unknown,
        Split.of(so_far, products, unseen),
    )


def _names(so_far: SoFar, which: Tensor) -> list[str]:
    """Names of some quantities of causes."""
    numbers = so_far.known[~so_far.own][which].tolist()
    return [so_far.coordinates.names[i] for i in numbers]


def _leading(unseen: Unseen, widest: Sequence[bool], widths: Tensor) -> int | None:
    """Number of the quantity that widens the least known goal most; None without any."""
    variances = unseen.variances(unseen.mean_square(), widest)
    return int(variances[int(widths.argmax())].argmax()) if variances.numel() else None


def _words(so_far: SoFar, unseen: Unseen, leading: int | None) -> tuple[str, bool]:
    """A quantity in words, and whether it is there for certain."""
    if leading is None:
        return "", False
    name = _names(so_far, so_far.model.is_asked)[leading]
    unit = so_far.coordinates.rig.parameters[name].unit
    size = f"{float(unseen.size[leading]):.2g}{'' if unit == '1' else ' ' + unit}"
    return f"{name} of {size}", float(unseen.probability[leading]) > SURE


def _given(so_far: SoFar, products: Products, unseen: Unseen, leading: int | None) -> Expected:
    """The linearised model of the candidates, given the readings, beside the quantity that widens most.

    All quantities at once would spread stops over what does not limit the goal: in the linear model of the paper's coil, a sixth more.
    """
    asked, every = so_far.own.clone(), so_far.model.every
    if leading is not None:
        asked[(~so_far.own).nonzero().flatten()[so_far.model.is_asked][leading]] = True
    precision = products.precision_of_draws[:, asked][..., asked]
    if leading is not None:
        place = int((asked & ~so_far.own)[asked].nonzero())
        certainty = 1.0 / torch.linalg.inv(precision)[:, place, place]
        # The first stop lessens a variance by its square times what the stop adds, whatever the law: a normal one stands for it.
        share = unseen.sd[leading].square() / unseen.variance[leading]
        precision[:, place, place] += (share - 1.0) * certainty
    return replace(every.only(asked), precision=precision)


def _noise_factor(so_far: SoFar, n_followed: float) -> float:
    """How much wider intervals are because the noise at the maximum is what free parameters leave of it.

    Each component adds 2 to the information on the logarithm of a noise, and its prior as much as some components would.
    """
    names = so_far.fit.coordinates.names
    is_noise = torch.tensor([name.endswith(".noise_T") for name in names])
    total = 0.5 * float(so_far.fit.precision.diagonal()[is_noise].sum())
    return 1.0 if not total else math.sqrt(total / max(total - n_followed, 1.0))


def misfit_of(
    so_far: SoFar, products: Products, covariance: Float[Tensor, "own own"], n_followed: float
) -> Misfit:
    """Compare what a fit leaves of its own readings, and of held-out ones, with the noise that repeated stops show.

    Args:
        so_far: The readings.
        products: These to first order about the estimate.
        covariance: Of the parameters of the fit.
        n_followed: Numbers that the fit takes from its readings rather than from the prior.
    """
    rows = so_far.rows
    n_again = len(rows) - len(set(rows))
    n_stops = sum(entry["is_validation"] for entry in so_far.entries)
    noise_T2, n_free = _noise_T2(so_far)
    if not so_far.n_held_out or not so_far.n_fitted or not n_free:
        return Misfit(0.0, math.nan, n_stops, n_again)
    own = products.columns[:, so_far.own]
    expected = (own @ covariance * own).sum(-1)
    left_T2, rest_T2, distance_sd = (products.residual * products.sigma_T).square(), 0.0, 0.0
    for is_held_out in (False, True):
        mine = products.is_held_out == is_held_out
        lost_T2 = (expected * products.sigma_T.square())[mine].sum() if is_held_out else 0.0
        n = max(int(mine.sum()) - (0.0 if is_held_out else n_followed), 1.0)
        mean_T2 = float(left_T2[mine].sum() - lost_T2) / n
        chance = float(fdtrc(n, n_free, max(mean_T2, 0.0) / noise_T2))
        each_sd = -float(ndtri(max(chance, SMALLEST)))
        distance_sd = max(distance_sd, each_sd)
        if each_sd > CLEAR_SD:
            rest_T2 = max(rest_T2, mean_T2 - noise_T2)
    return Misfit(math.sqrt(rest_T2), math.sqrt(noise_T2), n_stops, n_again, distance_sd)


def _noise_T2(so_far: SoFar) -> tuple[float, int]:
    """Variance within stops that were visited more than once, and its degrees of freedom."""
    by_row: dict[int, list[Tensor]] = {}
    for row, entry in zip(so_far.rows, so_far.entries, strict=True):
        by_row.setdefault(row, []).append(observations_of([entry], so_far.rig).field_sensor_T)
    total_T2, n_free = 0.0, 0
    for fields_T in by_row.values():
        if len(fields_T) > 1:
            visits_T = torch.stack(fields_T)
            measured = visits_T[:, ~visits_T.isnan().any(0)]
            total_T2 += float((measured - measured.mean(0)).square().sum())
            n_free += (len(visits_T) - 1) * measured.shape[1]
    return total_T2 / max(n_free, 1), n_free
