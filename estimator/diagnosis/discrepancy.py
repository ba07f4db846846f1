"""What no known cause explains: a flexible discrepancy that detects structure and bounds it, and never extrapolates.

Smooth functions of what a reading depends on (place, field, time, the move before it), each family scaled by its own amplitude and
given a normal prior that weakens with the order. Their evidence competes with that of the causes (DESIGN decision 7).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.linear import log_bayes_factor, log_mean_exp

AMPLITUDES = (0.5, 2.0, 8.0, 30.0)  # rms of a family in units of the noise
DEGREE = 4
TIME_DEGREE = 6


@dataclass(frozen=True)
class Family:
    """Columns that depend on one thing.

    Attributes:
        name: In words.
        columns: Whitened; their squares add up to 1 a component over all columns, on average.
    """

    name: str
    columns: Float[Tensor, "component column"]


@dataclass(frozen=True)
class Discrepancy:
    """Evidence for structure that is left.

    Attributes:
        log_bayes_factor: Against no structure, averaged over families and amplitudes.
        family: The one with the largest evidence.
        rms_sigma: Rms of that family's best curve, in units of the noise.
        fitted: Its whitened curve.
    """

    log_bayes_factor: float
    family: str
    by_family: dict[str, float]
    rms_sigma: float
    fitted: Float[Tensor, " component"]


def discrepancy(fit: Fit, families: list[Family]) -> Discrepancy:
    """How strongly the residual asks for structure beyond the fit."""
    projector, residual = fit.projector, fit.residual
    n_noise = float(len(residual)) if fit.is_noise_free else None
    evidence: dict[str, float] = {}
    best: tuple[float, Family | None, float] = (-torch.inf, None, 0.0)
    for family in families:
        gram = projector.gram(family.columns, family.columns)
        score = family.columns.T @ residual
        amplitudes = torch.tensor(AMPLITUDES, dtype=torch.float64)
        sd = amplitudes[:, None].expand(-1, len(score))
        log_bf = log_bayes_factor(gram.expand(len(sd), -1, -1), score.expand(len(sd), -1), sd, n_noise)
        evidence[family.name] = log_mean_exp(log_bf)
        top = int(log_bf.argmax())
        if float(log_bf[top]) > best[0]:
            best = (float(log_bf[top]), family, AMPLITUDES[top])
    _, strongest, amplitude = best
    assert strongest is not None
    columns = strongest.columns
    prior = torch.eye(columns.shape[1], dtype=torch.float64) / amplitude**2
    precision = projector.gram(columns, columns) + prior
    curve = columns @ torch.linalg.solve(precision, columns.T @ residual)
    total = log_mean_exp(torch.tensor(list(evidence.values()), dtype=torch.float64))
    return Discrepancy(total, strongest.name, evidence, float(curve.square().mean().sqrt()), curve)


def families(fit: Fit) -> list[Family]:
    """What a reading may smoothly depend on in this session; what is constant or linear has a name among the causes and is left out."""
    chain = fit.posterior.chain
    scene = chain.scene
    with torch.no_grad():
        predicted_T = chain.predict(fit.values)
    current = scene.current_A / scene.largest_current_A
    driven = current[:, 0] if current.shape[1] == 1 else current.abs().sum(1)
    by_component = torch.eye(3, dtype=torch.float64)
    time = 2.0 * scene.hours / scene.duration_h - 1.0
    clock = _legendre(time, TIME_DEGREE)[:, 1:]
    field = predicted_T / predicted_T.abs().max().clamp(min=1e-12)
    found: list[Family] = []

    def add(name: str, smooth: Tensor, vectors: Tensor) -> None:
        """Columns smooth(reading, k) x vectors(reading, 3, v)."""
        columns = torch.einsum("rk,rcv->rckv", smooth, vectors).flatten(2).movedim(-1, 0)
        whitened = fit.posterior.measured_components(columns).T * fit.whitening_per_T[:, None]
        norm = whitened.square().sum(1).mean().sqrt().clamp(min=1e-12)
        keep = whitened.norm(dim=0) > 1e-9 * norm
        if bool(keep.any()):
            found.append(Family(name, whitened[:, keep] / norm))

    each = by_component.expand(len(scene), 3, 3)
    for coil in chain.rig.coils:
        everywhere = torch.arange(len(chain.sensor))
        points_m, _ = chain.sensor_in_coil(coil, everywhere, fit.values)
        points_m = points_m.detach().expand(len(everywhere), 3)[chain.place]
        if not bool((points_m != points_m[0]).any()):
            continue  # coil and sensor both stand still
        place = _polynomials(_unit(points_m))
        add(f"place relative to {coil.name}, with the current", place * driven[:, None], each)
        if bool((driven != driven[0]).any()):
            add(f"place relative to {coil.name}, without current", place, each)
    add("time", clock[:, 1:], each)
    add("field and time", clock, torch.diag_embed(field))
    halves = torch.stack([(time > edge).to(torch.float64) for edge in (-0.6, -0.3, 0.0, 0.3, 0.6)], dim=1)
    swapped = torch.stack([torch.roll(field, shift, dims=1) for shift in range(3)], dim=-1)
    add("a change in mid session", halves, torch.cat((each, torch.diag_embed(field), swapped), dim=-1))
    add("the reading itself", _polynomials(_unit(field), lowest=2), each)
    before_T = _before(predicted_T, scene.observations.row)
    if before_T is not None:
        change = (before_T - predicted_T) / predicted_T.abs().max().clamp(min=1e-12)
        lag = torch.stack([torch.roll(change, shift, dims=1) for shift in range(3)], dim=-1)
        add("the reading before", torch.ones(len(scene), 1, dtype=torch.float64), lag)
    return found


def _unit(values: Float[Tensor, "reading axis"]) -> Float[Tensor, "reading axis"]:
    """Each axis on -1 .. 1."""
    low, high = values.min(0).values, values.max(0).values
    return (2.0 * values - low - high) / (high - low).clamp(min=1e-12)


def _legendre(x: Float[Tensor, " reading"], degree: int) -> Float[Tensor, "reading order"]:
    """Legendre polynomials up to a degree, the higher the weaker."""
    orders = [torch.ones_like(x), x]
    for n in range(1, degree):
        orders.append(((2 * n + 1) * x * orders[n] - n * orders[n - 1]) / (n + 1))
    return torch.stack([order / (1.0 + 0.5 * n) for n, order in enumerate(orders)], dim=1)


def _polynomials(x: Float[Tensor, "reading axis"], lowest: int = 1) -> Float[Tensor, "reading order"]:
    """Products of Legendre polynomials in three axes from a lowest to a highest total degree."""
    one, two, three = (_legendre(x[:, i], DEGREE) for i in range(3))
    return torch.stack(
        [
            one[:, i] * two[:, j] * three[:, k]
            for i in range(DEGREE + 1)
            for j in range(DEGREE + 1 - i)
            for k in range(DEGREE + 1 - i - j)
            if i + j + k >= lowest
        ],
        dim=1,
    )


def _before(predicted_T: Float[Tensor, "reading 3"], row: Tensor) -> Float[Tensor, "reading 3"] | None:
    """Predicted field of the reading taken before each, among those at hand; None where most are missing."""
    order = torch.argsort(row)
    before = torch.empty_like(order)
    before[order[1:]] = order[:-1]
    before[order[0]] = order[0]
    return predicted_T[before]
