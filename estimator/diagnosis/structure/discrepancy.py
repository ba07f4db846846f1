"""Flexible discrepancy for what no known cause explains: it detects structure and bounds it, but never extrapolates.

Each family of columns holds smooth functions of one covariate (position, field, time, the previous reading), with an amplitude of its own
and a normal prior that narrows with the order. Its evidence competes with that of the causes (docs/decisions/0008).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.linear import log_bayes_factor, log_mean_exp
from estimator.diagnosis.structure.harmonics import harmonic_gradients
from estimator.diagnosis.structure.memory import lingering_T
from estimator.diagnosis.structure.smooth import legendre, polynomials, unit_interval
from estimator.diagnosis.structure.winding_shapes import shape_fields
from estimator.model.bodies import winding_of
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.rig import Coil


@dataclass(frozen=True)
class Family:
    """Columns that depend on one covariate.

    Attributes:
        name: In words; families with the same name are alternatives.
        columns: Whitened; the mean over components of their summed squares is 1.
    """

    name: str
    columns: Float[Tensor, "component column"]

    @classmethod
    def of(cls, name: str, whitened: Float[Tensor, "component column"]) -> Family:
        """The family of columns given at any common scale."""
        return cls(name, whitened / whitened.square().sum(1).mean().sqrt().clamp(min=1e-300))

    def weighed(self, weight: Float[Tensor, " component"]) -> Family:
        """The family with each component's weight multiplied; amplitudes stay in units of the noise."""
        return Family.of(self.name, self.columns * weight[:, None])


@dataclass(frozen=True)
class Discrepancy:
    """Evidence for structure in a residual.

    Attributes:
        log_bayes_factor: Against no structure, averaged over families and amplitudes.
        family: Name of the family with the largest evidence.
        by_family: Log Bayes factor by name of family.
        rms_sigma: Rms of the most probable curve of that family, less what the fit can follow, in units of the noise.
        columns: Whitened columns of that family, with standard normal coefficients.
    """

    log_bayes_factor: float
    family: str
    by_family: dict[str, float]
    rms_sigma: float
    columns: Float[Tensor, "component column"]

    def weighed(self, weight: Float[Tensor, " component"]) -> Discrepancy:
        """The discrepancy with each component's weight multiplied; its rms in units of the noise stays."""
        amplitude = self.columns.square().sum(1).mean().sqrt()
        return replace(
            self, columns=amplitude * Family.of(self.family, self.columns * weight[:, None]).columns
        )


def discrepancy(fit: Fit, families: list[Family]) -> Discrepancy:
    """Evidence for structure in the residual of a fit, from some families of curves."""
    evidence: dict[str, list[Tensor]] = {}
    best: tuple[float, Family | None, float] = (-torch.inf, None, 0.0)
    for family in families:
        log_bf = evidence_by_amplitude(fit, family)
        evidence.setdefault(family.name, []).append(log_bf)
        top = int(log_bf.argmax())
        if float(log_bf[top]) > best[0]:
            best = (float(log_bf[top]), family, policy.AMPLITUDES[top])
    by_family = {name: log_mean_exp(torch.cat(parts)) for name, parts in evidence.items()}
    total = log_mean_exp(torch.tensor(list(by_family.values()), dtype=torch.float64))
    _, strongest, amplitude = best
    assert strongest is not None
    curve = fit.projector.rest(_curve(fit, strongest.columns, amplitude))
    rms_sigma = float(curve.square().mean().sqrt())
    return Discrepancy(total, strongest.name, by_family, rms_sigma, amplitude * strongest.columns)


def evidence_by_amplitude(fit: Fit, family: Family) -> Float[Tensor, " amplitude"]:
    """Log Bayes factor of a family against no structure, for each of `policy.AMPLITUDES`."""
    gram = fit.projector.gram(family.columns, family.columns)
    score = family.columns.T @ fit.residual
    sd = torch.tensor(policy.AMPLITUDES, dtype=torch.float64)[:, None].expand(-1, len(score))
    return log_bayes_factor(gram.expand(len(sd), -1, -1), score.expand(len(sd), -1), sd, fit.free_noise)


def _curve(fit: Fit, columns: Tensor, amplitude: float) -> Tensor:
    """The most probable combination of columns."""
    prior = torch.eye(columns.shape[1], dtype=torch.float64) / amplitude**2
    precision = fit.projector.gram(columns, columns) + prior
    curve: Tensor = columns @ torch.linalg.solve(precision, columns.T @ fit.residual)
    return curve


def families(fit: Fit) -> list[Family]:
    """The families of a session. Constant and linear terms are left out, for causes stand for them."""
    model = fit.posterior.model
    circumstances = model.circumstances
    with torch.no_grad():
        predicted_T = model.predict(fit.values).expand(len(circumstances), 3)
    axes = torch.eye(3, dtype=torch.float64).expand(len(circumstances), 3, 3)
    field = predicted_T / predicted_T.abs().max().clamp(min=1e-12)
    mixed = torch.cat([torch.diag_embed(torch.roll(field, shift, dims=1)) for shift in range(3)], dim=-1)
    constant = torch.ones(len(circumstances), 1, dtype=torch.float64)
    time = 2.0 * circumstances.hours / circumstances.duration_h - 1.0
    clock = legendre(time, policy.TIME_DEGREE)[:, 1:]
    collection = Collection(fit)
    for coil in model.rig.coils:
        _add_positions(collection, model, coil, fit)
    collection.add("time", clock[:, 1:], axes)
    collection.add("field and time", clock, torch.diag_embed(field))
    for instant in torch.linspace(-1.0, 1.0, policy.N_INSTANTS + 2).tolist()[1:-1]:
        later = (time > instant).to(torch.float64)
        for i in range(len(model.rig.sensors)):
            later_by_sensor = (later * (circumstances.sensor == i))[:, None]
            if bool(later_by_sensor.any()):
                collection.add("a change in mid session", later_by_sensor, axes)
                collection.add("a change in mid session", later_by_sensor, torch.cat((axes, mixed), dim=-1))
    collection.add("the reading itself", polynomials(unit_interval(field), 2, policy.SMOOTH_DEGREE), axes)
    for changes_T in _changes(fit, predicted_T):
        change = changes_T / changes_T.abs().max().clamp(min=1e-12)
        rolled = [torch.diag_embed(torch.roll(change, k, dims=1)) for k in range(3)]
        collection.add("the readings before", constant, change[:, :, None])
        collection.add("the readings before", constant, torch.cat(rolled, dim=-1))
    return collection.families


def _changes(fit: Fit, predicted_T: Float[Tensor, "reading 3"]) -> list[Float[Tensor, "reading 3"]]:
    """The last change of the field, and the exponentially fading sums of all changes."""
    last_T = before(predicted_T, fit.observations.row) - predicted_T
    lingering = [lingering_T(fit, steps) for steps in policy.DECAY_STEPS]
    return [last_T, *(field_T for field_T in lingering if field_T is not None)]


class Collection:
    """Collects families for one fit; columns that vanish are left out."""

    def __init__(self, fit: Fit) -> None:
        self.fit = fit
        self.families: list[Family] = []

    def add(
        self,
        name: str,
        smooth: Float[Tensor, "reading order"],
        vectors: Float[Tensor, "reading 3 direction"],
    ) -> None:
        """Add the products of smooth functions and vectors."""
        self.add_fields(name, torch.einsum("rk,rcv->rkvc", smooth, vectors).flatten(1, 2))

    def add_fields(self, name: str, fields: Float[Tensor, "reading column 3"]) -> None:
        """Add columns given by reading and component."""
        columns = self.fit.posterior.measured_components(fields.movedim(1, 0)).T
        whitened = columns * self.fit.whitening_per_T[:, None]
        norm = whitened.square().sum(1).mean().sqrt().clamp(min=1e-300)
        is_nonzero = whitened.norm(dim=0) > 1e-9 * norm * len(whitened) ** 0.5
        if bool(is_nonzero.any()):
            self.families.append(Family.of(name, whitened[:, is_nonzero]))


def _add_positions(collection: Collection, model: MeasurementModel, coil: Coil, fit: Fit) -> None:
    """Add fields that move with a coil: arbitrary smooth ones, and those of sources outside the workspace."""
    circumstances = model.circumstances
    all_rows = torch.arange(len(model.sensor))
    with torch.no_grad():
        points_m, sensor_from_coil = model.sensor_in_coil(coil, all_rows, fit.values)
    points_m = points_m.expand(len(all_rows), 3)[model.pose_row]
    if not bool((points_m != points_m[0]).any()):
        return  # coil and sensor do not move relative to each other
    rotation = sensor_from_coil.expand(len(all_rows), 3, 3)[model.pose_row]
    current = circumstances.current_A[:, list(model.rig.coils).index(coil)] / circumstances.largest_current_A
    position = unit_interval(points_m)
    middle = points_m.mean(0)
    inner = (points_m - middle) / (points_m - middle).norm(dim=-1).max()
    fields = [
        torch.einsum("rij,rtj->rti", rotation, harmonic_gradients(inner, degree)) / degree**2
        for degree in range(2, policy.HARMONIC_DEGREE + 1)
    ]
    source = torch.cat(fields, dim=1)
    winding = winding_of(model.rig, coil, fit.values)
    nearby = torch.einsum("rij,rtj->rti", rotation, dipoles(points_m / winding.radius_m))
    shapes = torch.einsum("rij,rtj->rti", rotation, shape_fields(points_m, winding))
    collection.add_fields(f"the shape of the winding of {coil.name}", shapes * current[:, None, None])
    drives = {f"position relative to {coil.name}, with its current": current}
    if bool((current.abs() != current.abs()[0]).any() or (current != current[0]).any()):
        drives[f"position relative to {coil.name}, without current"] = torch.ones_like(current)
    for name, drive in drives.items():
        collection.add(name, polynomials(position, 1, policy.SMOOTH_DEGREE) * drive[:, None], rotation)
        collection.add(name, polynomials(position, 1, policy.COARSE_DEGREE) * drive[:, None], rotation)
        collection.add_fields(name, source * drive[:, None, None])
        collection.add_fields(name, nearby * drive[:, None, None])


def dipoles(points: Float[Tensor, "reading 3"]) -> Float[Tensor, "reading column 3"]:
    """Fields of dipoles along each axis in and around a coil of radius 1, which move with it."""
    positions = [(0, 0, -0.3), (1.2, 0, -0.6), (-1.2, 0, -0.6), (0, 1.2, -0.6), (0, -1.2, -0.6), (0, 0, -2.0)]
    columns = []
    for position in positions:
        arm = points - torch.tensor(position, dtype=points.dtype)
        r2 = (arm**2).sum(-1, keepdim=True)
        for axis in range(3):
            moment = torch.eye(3, dtype=points.dtype)[axis]
            columns.append((3.0 * arm[:, axis : axis + 1] * arm - r2 * moment) * r2**-2.5)
    return torch.stack(columns, dim=1)


def before(predicted_T: Float[Tensor, "reading 3"], row: Tensor) -> Float[Tensor, "reading 3"]:
    """Predicted field of the reading taken before each one, among the given readings."""
    order = torch.argsort(row)
    previous = torch.empty_like(order)
    previous[order[1:]] = order[:-1]
    previous[order[0]] = order[0]
    return predicted_T[previous]
