"""Every effect keeps device and precision: what is predicted on another device equals what the processor says, in single precision nearly."""

from __future__ import annotations

import pytest
import torch

from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates, nominal_tensors
from estimator.rig.rig import Cause, Rig
from tests.contract.test_effects import CASES, observations, rig  # noqa: F401  (fixtures)
from tests.far import far_device

pytestmark = pytest.mark.whole
SINGLE = 2e-5  # of the largest component
FIRST_PLACES = dict(reversed(CASES))
FIRST_OF_FILES = {type(EFFECTS[name]).__module__: name for name in reversed(FIRST_PLACES)}.values()
EACH = [  # one cause of each file in every run, the others among the slow tests
    pytest.param(name, place, marks=() if name in FIRST_OF_FILES else pytest.mark.slow)
    for name, place in FIRST_PLACES.items()
]
FITTED = {name: place for name, place in FIRST_PLACES.items() if not EFFECTS[name].is_record_mistake}


def predicted(rig_with_cause: Rig, readings: Observations, shifted: dict[str, float]) -> torch.Tensor:
    """Prediction away from the null, on the device and in the precision of the readings."""
    model = MeasurementModel.build(rig_with_cause, readings)
    values = nominal_tensors(rig_with_cause, readings.current_A)
    values |= {key: values[key] + shift for key, shift in shifted.items()}
    return model.predict(values).expand(len(readings), 3)


def case(described: Rig, readings: Observations, name: str, place: str) -> tuple[Rig, dict[str, float]]:
    circumstances = MeasurementModel.unruled(described, readings).circumstances
    shapes = EFFECTS[name].starts(circumstances, place)[0]
    quantities = EFFECTS[name].quantities(circumstances.extent)
    shifted = {
        f"{name}[{place}].{q.key}": 0.3 * q.prior.sd for q in quantities if not (q.is_shape or q.is_fixed)
    }
    rig_with_cause = with_effect(described, Cause(name, place), readings, shapes)
    return rig_with_cause, {key: v for key, v in shifted.items() if key in rig_with_cause.parameters}


@pytest.mark.parametrize(("name", "place"), EACH)
def test_prediction_on_another_device(rig, observations, name, place):  # noqa: F811
    rig_with_cause, shifted = case(rig, observations, name, place)
    near_T = predicted(rig_with_cause, observations, shifted)
    with far_device() as far:
        far_T = predicted(rig_with_cause, observations.to(far), shifted)
        assert (far_T.device, far_T.dtype) == (far, torch.float64)
        # A magnetised ring is the difference of two loops, which rounds to 1e-16 T here.
        torch.testing.assert_close(far_T.cpu(), near_T, rtol=1e-11, atol=1e-15)


@pytest.mark.parametrize(("name", "place"), FIRST_PLACES.items())
def test_prediction_in_single_precision(rig, observations, name, place):  # noqa: F811
    rig_with_cause, shifted = case(rig, observations, name, place)
    double_T = predicted(rig_with_cause, observations, shifted)
    single_T = predicted(rig_with_cause, observations.to(dtype=torch.float32), shifted)
    assert single_T.dtype == torch.float32
    error_T = (single_T - double_T).abs()
    if name in ("range_clipping", "current_dead_band"):
        error_T = error_T.sort().values[..., :-1]
    assert float(error_T.max()) < SINGLE * float(double_T.abs().max())


@pytest.mark.slow
@pytest.mark.parametrize(("name", "place"), FITTED.items())
def test_density_and_its_derivatives_on_another_device(rig, observations, name, place):  # noqa: F811
    rig_with_cause, _ = case(rig, observations, name, place)
    coordinates = Coordinates(rig_with_cause)
    if not coordinates.n:
        return

    def results(readings: Observations) -> tuple[torch.Tensor, ...]:
        posterior = LogPosterior(coordinates, MeasurementModel.build(rig_with_cause, readings), readings)
        start = posterior.coordinates.start()
        density = posterior(torch.stack((start, start + 0.1 * posterior.coordinates.scale)))
        return density, *posterior.to_first_order(start)

    near = results(observations)
    with far_device() as far:
        for here, there in zip(near, results(observations.to(far)), strict=True):
            assert there.device == far
            # A graphics processor rounds otherwise, and derivatives in amplitudes are differences over a thousandth.
            torch.testing.assert_close(there.cpu(), here, rtol=1e-9, atol=1e-9 * float(here.abs().max()))
