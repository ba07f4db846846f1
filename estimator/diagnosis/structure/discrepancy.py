"""What no known cause explains: a flexible discrepancy that detects structure and bounds it, and never extrapolates.

Smooth functions of what a reading depends on (place, field, time, the move before it), each family scaled by its own amplitude and
given a normal prior that weakens with the order. Their evidence competes with that of the causes (docs/decisions/0008).
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
    """Columns that depend on one thing.

    Attributes:
        name: In words; families of one name are alternatives of each other.
        columns: Whitened; their squares add up to 1 a component over all columns, on average.
    """

    name: str
    columns: Float[Tensor, "component column"]

    @classmethod
    def of(cls, name: str, whitened: Float[Tensor, "component column"]) -> Family:
        """Of columns at any common scale."""
        return cls(name, whitened / whitened.square().sum(1).mean().sqrt().clamp(min=1e-300))

    def weighed(self, weight: Float[Tensor, " component"]) -> Family:
        """The same where each component weighs so many times what it did; its amplitudes stay in units of the noise."""
        return Family.of(self.name, self.columns * weight[:, None])


@dataclass(frozen=True)
class Discrepancy:
    """Evidence for structure that is left.

    Attributes:
        log_bayes_factor: Against no structure, averaged over families and amplitudes.
        family: The one with the largest evidence.
        by_family: Log Bayes factor of each.
        rms_sigma: Rms of that family's best curve, less what the fit can follow of it, in units of the noise.
        columns: Whitened, that family's, with standard normal coefficients.
    """

    log_bayes_factor: float
    family: str
    by_family: dict[str, float]
    rms_sigma: float
    columns: Float[Tensor, "component column"]

    def weighed(self, weight: Float[Tensor, " component"]) -> Discrepancy:
        """The same where each component weighs so many times what it did; as large as before in units of the noise."""
        amplitude = self.columns.square().sum(1).mean().sqrt()
        return replace(
            self, columns=amplitude * Family.of(self.family, self.columns * weight[:, None]).columns
        )


def discrepancy(fit: Fit, families: list[Family]) -> Discrepancy:
    """How strongly the residual asks for structure beyond the fit."""
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
    """What a reading may smoothly depend on in this session; what is constant or linear has a name among the causes and is left out."""
    model = fit.posterior.model
    circumstances = model.circumstances
    with torch.no_grad():
        predicted_T = model.predict(fit.values).expand(len(circumstances), 3)
    each = torch.eye(3, dtype=torch.float64).expand(len(circumstances), 3, 3)
    field = predicted_T / predicted_T.abs().max().clamp(min=1e-12)
    mixed = torch.cat([torch.diag_embed(torch.roll(field, shift, dims=1)) for shift in range(3)], dim=-1)
    one = torch.ones(len(circumstances), 1, dtype=torch.float64)
    time = 2.0 * circumstances.hours / circumstances.duration_h - 1.0
    clock = legendre(time, policy.TIME_DEGREE)[:, 1:]
    found = Collection(fit)
    for coil in model.rig.coils:
        _add_places(found, model, coil, fit)
    found.add("time", clock[:, 1:], each)
    found.add("field and time", clock, torch.diag_embed(field))
    for edge in torch.linspace(-1.0, 1.0, policy.N_INSTANTS + 2).tolist()[1:-1]:
        later = (time > edge).to(torch.float64)
        for i in range(len(model.rig.sensors)):
            mine = (later * (circumstances.sensor == i))[:, None]
            if bool(mine.any()):
                found.add("a change in mid session", mine, each)
                found.add("a change in mid session", mine, torch.cat((each, mixed), dim=-1))
    found.add("the reading itself", polynomials(unit_interval(field), 2, policy.SMOOTH_DEGREE), each)
    for changes_T in _changes(fit, predicted_T):
        change = changes_T / changes_T.abs().max().clamp(min=1e-12)
        rolled = [torch.diag_embed(torch.roll(change, k, dims=1)) for k in range(3)]
        found.add("the readings before", one, change[:, :, None])
        found.add("the readings before", one, torch.cat(rolled, dim=-1))
    return found.families


def _changes(fit: Fit, predicted_T: Float[Tensor, "reading 3"]) -> list[Float[Tensor, "reading 3"]]:
    """The last change of the field, and what lingers of all changes for some time."""
    last_T = before(predicted_T, fit.observations.row) - predicted_T
    lingering = [lingering_T(fit, steps) for steps in policy.DECAY_STEPS]
    return [last_T, *(one for one in lingering if one is not None)]


class Collection:
    """Families as they are made."""

    def __init__(self, fit: Fit) -> None:
        self.fit = fit
        self.families: list[Family] = []

    def add(
        self,
        name: str,
        smooth: Float[Tensor, "reading order"],
        vectors: Float[Tensor, "reading 3 direction"],
    ) -> None:
        """Columns smooth x vectors."""
        self.add_fields(name, torch.einsum("rk,rcv->rkvc", smooth, vectors).flatten(1, 2))

    def add_fields(self, name: str, fields: Float[Tensor, "reading column 3"]) -> None:
        """Columns given by reading and component."""
        columns = self.fit.posterior.measured_components(fields.movedim(1, 0)).T
        whitened = columns * self.fit.whitening_per_T[:, None]
        norm = whitened.square().sum(1).mean().sqrt().clamp(min=1e-300)
        is_there = whitened.norm(dim=0) > 1e-9 * norm * len(whitened) ** 0.5
        if bool(is_there.any()):
            self.families.append(Family.of(name, whitened[:, is_there]))


def _add_places(found: Collection, model: MeasurementModel, coil: Coil, fit: Fit) -> None:
    """Fields that move with a coil: of any kind, and those that sources outside the workspace can make."""
    circumstances = model.circumstances
    everywhere = torch.arange(len(model.sensor))
    with torch.no_grad():
        points_m, sensor_from_coil = model.sensor_in_coil(coil, everywhere, fit.values)
    points_m = points_m.expand(len(everywhere), 3)[model.pose_row]
    if not bool((points_m != points_m[0]).any()):
        return  # coil and sensor both stand still
    turn = sensor_from_coil.expand(len(everywhere), 3, 3)[model.pose_row]
    current = circumstances.current_A[:, list(model.rig.coils).index(coil)] / circumstances.largest_current_A
    place = unit_interval(points_m)
    middle = points_m.mean(0)
    inner = (points_m - middle) / (points_m - middle).norm(dim=-1).max()
    fields = [
        torch.einsum("rij,rtj->rti", turn, harmonic_gradients(inner, degree)) / degree**2
        for degree in range(2, policy.HARMONIC_DEGREE + 1)
    ]
    source = torch.cat(fields, dim=1)
    winding = winding_of(model.rig, coil, fit.values)
    nearby = torch.einsum("rij,rtj->rti", turn, dipoles(points_m / winding.radius_m))
    shapes = torch.einsum("rij,rtj->rti", turn, shape_fields(points_m, winding))
    found.add_fields(f"the shape of the winding of {coil.name}", shapes * current[:, None, None])
    drives = {f"place relative to {coil.name}, with its current": current}
    if bool((current.abs() != current.abs()[0]).any() or (current != current[0]).any()):
        drives[f"place relative to {coil.name}, without current"] = torch.ones_like(current)
    for name, drive in drives.items():
        found.add(name, polynomials(place, 1, policy.SMOOTH_DEGREE) * drive[:, None], turn)
        found.add(name, polynomials(place, 1, policy.COARSE_DEGREE) * drive[:, None], turn)
        found.add_fields(name, source * drive[:, None, None])
        found.add_fields(name, nearby * drive[:, None, None])


def dipoles(points: Float[Tensor, "reading 3"]) -> Float[Tensor, "reading column 3"]:
    """Fields of dipoles along each axis in and around a coil of radius 1: sources that move with it."""
    places = [(0, 0, -0.3), (1.2, 0, -0.6), (-1.2, 0, -0.6), (0, 1.2, -0.6), (0, -1.2, -0.6), (0, 0, -2.0)]
    columns = []
    for place in places:
        arm = points - torch.tensor(place, dtype=points.dtype)
        r2 = (arm**2).sum(-1, keepdim=True)
        for axis in range(3):
            moment = torch.eye(3, dtype=points.dtype)[axis]
            columns.append((3.0 * arm[:, axis : axis + 1] * arm - r2 * moment) * r2**-2.5)
    return torch.stack(columns, dim=1)


def before(predicted_T: Float[Tensor, "reading 3"], row: Tensor) -> Float[Tensor, "reading 3"]:
    """Predicted field of the reading taken before each, among those at hand."""
    order = torch.argsort(row)
    before = torch.empty_like(order)
    before[order[1:]] = order[:-1]
    before[order[0]] = order[0]
    return predicted_T[before]
