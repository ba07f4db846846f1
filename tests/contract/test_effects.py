"""Every effect at every place: null changes nothing, a batch equals a loop, derivatives agree with differences, names and units are in order."""

from __future__ import annotations

from pkgutil import iter_modules
from typing import Any

import pytest
import torch
from torch.func import jvp

from estimator.diagnosis.extension import extended_rig
from estimator.diagnosis.fitting import fit_rig
from estimator.effects import CAUSES, EFFECTS, causes
from estimator.effects.attach import with_effect
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.stages import NoiseEffect
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.read import rig_from_text
from estimator.rig_files.write import rig_text
from tests.every_cause import RIG


@pytest.fixture(scope="module")
def rig() -> Rig:
    return DESCRIBED


@pytest.fixture(scope="module")
def observations(rig) -> Observations:
    n = 24
    random = torch.Generator().manual_seed(3)
    motion = torch.zeros(n, 6, dtype=torch.float64)
    motion[:, :3] = 0.02 * (torch.rand(n, 3, generator=random, dtype=torch.float64) - 0.5)
    current_A = torch.stack(
        (torch.tensor([2.0, -2.0, 1.0, 0.0]).repeat(6), torch.tensor([0.0, 0.0, 1.0]).repeat(8)), dim=1
    )
    warm = {
        name: 20.0 + torch.rand(n, generator=random, dtype=torch.float64)
        for name in ("hall", "other", "coil1")
    }
    empty = Observations.of(
        current_A.double(),
        {"arm1": motion, "arm2": motion.flip(-1)},
        torch.full((n, 3), 1e-3, dtype=torch.float64),
        time_s=2.0 * torch.arange(n, dtype=torch.float64),
        sensor=torch.arange(n) % 2,
        temperature_C=warm,
        recorded_segment=torch.arange(n) // 9,
    )
    values = {k: torch.tensor(v, dtype=torch.float64) for k, v in rig.nominal_values().items()}
    return empty.with_field(MeasurementModel.build(rig, empty).predict(values))


DESCRIBED = rig_from_text(RIG)
CASES = [(name, place) for name, effect in EFFECTS.items() for place in effect.places(DESCRIBED)]


def at_places(*kinds: type) -> list[Any]:
    """Each cause at its last place, and among the slow tests at the others; without those of some kinds."""
    last = dict(CASES)
    return [
        pytest.param(name, place, marks=() if last[name] == place else pytest.mark.slow)
        for name, place in CASES
        if not isinstance(EFFECTS[name], kinds)
    ]


@pytest.fixture(scope="module")
def plain(rig, observations) -> MeasurementModel:
    """The model without a cause."""
    return MeasurementModel.build(rig, observations)


def model_with(plain: MeasurementModel, cause: Cause) -> tuple[MeasurementModel, dict[str, torch.Tensor]]:
    """The model with a cause, by the quadrature rules of the one without, and nominal values."""
    readings = plain.circumstances.observations
    shapes = EFFECTS[cause.name].starts(plain.circumstances, cause.place)[0]
    rig_with_cause = with_effect(plain.rig, cause, readings, shapes)
    values = {k: torch.tensor(v, dtype=torch.float64) for k, v in rig_with_cause.nominal_values().items()}
    return MeasurementModel.unruled(rig_with_cause, readings).with_rules(plain.rules), values


@pytest.mark.parametrize(
    ("name", "place"), [case for case in at_places() if not EFFECTS[case.values[0]].is_record_mistake]
)
def test_null_is_identity(plain, observations, name, place):
    model, values = model_with(plain, Cause(name, place))
    for quantity in EFFECTS[name].quantities(model.circumstances.extent):
        if not quantity.is_shape:  # some fits start away from the null
            values[f"{name}[{place}].{quantity.key}"] = torch.tensor(quantity.null, dtype=torch.float64)
    predicted_T = model.predict(values).expand(24, 3)
    assert predicted_T.isfinite().all(), (
        "also where there is no current or no field, as in every fourth reading"
    )
    torch.testing.assert_close(predicted_T, observations.field_sensor_T, rtol=1e-12, atol=1e-18)


@pytest.mark.whole
@pytest.mark.parametrize(("name", "place"), at_places(NoiseEffect))
def test_batch_equals_loop_and_derivative_equals_difference(plain, name, place):
    model, values = model_with(plain, Cause(name, place))
    extent = model.circumstances.extent
    for quantity in EFFECTS[name].quantities(extent):
        if quantity.is_shape or quantity.is_fixed:
            continue
        key = f"{name}[{place}].{quantity.key}"
        step = 1e-3 * quantity.prior.sd
        ends = values[key] + step * torch.tensor([-1.0, 0.0, 1.0], dtype=torch.float64)
        together = model.predict({**values, key: ends}).expand(3, 24, 3)
        for end, field in zip(ends, together, strict=True):
            torch.testing.assert_close(
                model.predict({**values, key: end}).expand(24, 3), field, rtol=1e-12, atol=1e-18
            )
        assert together.dtype == torch.float64
        if name in ("range_clipping", "current_limit"):
            continue  # its response has a kink
        _, slope = jvp(
            lambda v, key=key: model.predict({**values, key: v}).expand(24, 3),
            (values[key],),
            (torch.ones_like(values[key]),),
        )
        difference = (together[2] - together[0]) / (2.0 * step)
        scale = difference.abs().max()
        rounding = max(1e-10, 4.0 * torch.finfo(torch.float64).eps / step)  # as a coil turns about its axis
        torch.testing.assert_close(
            slope, difference, rtol=0.0, atol=float(1e-4 * scale + rounding * together.abs().max())
        )


@pytest.mark.parametrize(("name", "place"), at_places(NoiseEffect))
def test_some_readings_are_predicted_as_among_all_others(plain, name, place):
    """Large sessions are evaluated part by part; an effect that looks back has the whole session to look at."""
    model, values = model_with(plain, Cause(name, place))
    for quantity in EFFECTS[name].quantities(model.circumstances.extent):
        if not (quantity.is_shape or quantity.is_fixed):
            values[f"{name}[{place}].{quantity.key}"] += 0.5 * quantity.prior.sd
    part = torch.arange(5, 14)
    torch.testing.assert_close(
        model.part(part).predict(values).expand(9, 3),
        model.predict(values).expand(24, 3)[part],
        rtol=1e-12,
        atol=1e-18,
    )


def test_fits_start_within_the_priors(plain):
    for name, place in CASES:
        circumstances = plain.circumstances
        priors = {q.key: q.prior for q in EFFECTS[name].quantities(circumstances.extent)}
        for shapes in EFFECTS[name].starts(circumstances, place):
            for key, value in shapes.items():
                assert priors[key].lower <= value <= priors[key].upper, (name, place, key, value)


def test_declarations_are_complete():
    for name, effect in EFFECTS.items():
        assert effect.name == name
        assert effect.words, name
        assert effect.source, name
        keys = [quantity.key for quantity in effect.quantities(Extent())]
        assert len(set(keys)) == len(keys) > 0, name
        for quantity in effect.quantities(Extent()):
            suffix = quantity.unit.replace(" ", "_").replace("/", "_per_").replace("1_per_", "per_")
            assert quantity.unit == "1" or quantity.key.endswith(suffix), quantity


def test_every_module_of_causes_has_its_place_in_the_measurement():
    """One that `CAUSES` of `estimator/effects/__init__.py` does not list is never loaded."""
    assert sorted(module.name for module in iter_modules(causes.__path__)) == sorted(CAUSES)


@pytest.mark.parametrize("pitch", ["axial_pitch", "radial_pitch"])
def test_pitch_that_the_rig_file_leaves_open_within_bounds_is_no_cause_beside(observations, pitch):
    """As the MICE windings do: a cause of 5 % would leave the three widths within which they can be built."""
    of_its_own = f"wire_radius_mm: 0.5\n    {pitch}_mm: {{prior: {{normal: {{mean: 1, sd: 0.01}}}}}}"
    open_pitch = rig_from_text(RIG.replace("wire_radius_mm: 0.5", of_its_own, 1))
    circumstances = Circumstances(open_pitch, observations)
    assert not EFFECTS[pitch].concerns(circumstances, "coil1")
    assert EFFECTS[pitch].concerns(circumstances, "coil2")


@pytest.mark.whole
@pytest.mark.parametrize(
    "name",
    [
        "axis_gain",
        "base_misplaced",
        "coil_heating",
        "iron_plate",
        "joint_zeros",
        "mount_tilt",
        "segment_misplaced",
        "segment_zero",
        "sensor_bumped",
        "position_jitter",
        "outliers",
    ],
)
def test_rig_file_with_the_effect_predicts_the_same(plain, observations, name):
    cause = Cause(name, EFFECTS[name].places(plain.rig)[0])
    model, values = model_with(plain, cause)
    fit = fit_rig(model.rig, observations, values, model.rules)
    again = rig_from_text(rig_text(extended_rig(plain.rig, fit)))
    assert again.effects == (cause,)
    for parameter in (p for p in again.parameters.values() if p.name.startswith(cause.label)):
        known = model.rig.parameters[parameter.name]
        assert (parameter.prior, parameter.unit) == (known.prior, known.unit)
        assert parameter.value == pytest.approx(float(fit.values[parameter.name]), rel=1e-12, abs=1e-300)


@pytest.mark.parametrize(
    ("name", "key"), [(name, key) for name, effect in EFFECTS.items() for key in effect.never_negative]
)
def test_what_is_never_negative_is_something_else_below_zero(plain, name, key):
    """A current that grows as the coil warms up is no loss; a fit with it counts for nothing (`Fit.still_has`)."""
    keys = {quantity.key for quantity in EFFECTS[name].quantities(Extent())}
    theta = {each: torch.tensor(0.0, dtype=torch.float64) for each in keys}
    assert EFFECTS[name].is_itself(theta, plain.circumstances)
    assert EFFECTS[name].is_itself({**theta, key: theta[key] + 1e-3}, plain.circumstances)
    assert not EFFECTS[name].is_itself({**theta, key: theta[key] - 1e-3}, plain.circumstances)
