"""Widened intervals contain the truth where the readings hold something that no cause explains."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from estimator.diagnosis import widening
from estimator.diagnosis.corrections.kinds import kinds_of
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.mixture.numbers import Numbers
from estimator.diagnosis.structure.jackknife import jackknife_covariance
from estimator.diagnosis.widening import LEAST_SHARE, Widening, back_to_priors, envelope, within_prior
from estimator.readings.metrics import HALF_WIDTH_90
from estimator.readings.split import pose_blocks, time_blocks
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.read import rig_from_text
from estimator.store.session import Session
from tests.estimator.conftest import RIG
from tests.estimator.diagnosis.small_fits import fit_of

RADIUS, COUNT = "coil1.radius_m", "coil1.axial_loops"


@pytest.fixture(scope="module")
def fit(small_rig: Rig, small_session: Session) -> Fit:
    return fit_of(small_rig, small_session.observations)


@pytest.mark.slow
def test_blocks_know_of_a_field_that_the_noise_does_not(fit):
    """Over many draws of field and noise, in the linear model about the fit. Blocks must not be smaller than the structure."""
    kinds = [kind for kind in kinds_of(fit) if kind.cause == Cause("coil_harmonics", "coil1")]
    (columns,) = kinds[0].columns(fit, kinds[0].starts, 4)
    columns = columns[:, len(kinds[0].keys(2)) :]
    columns = 4.0 * columns / columns.square().sum(1).mean().sqrt()
    generator = torch.Generator().manual_seed(13)
    block = pose_blocks(fit.observations, np.random.default_rng(0))
    by_noise, by_block = [], []
    sd = torch.sqrt(torch.diagonal(fit.covariance))
    for _ in range(600):
        readings = torch.randn(len(columns), generator=generator, dtype=torch.float64)
        readings += columns @ torch.randn(columns.shape[1], generator=generator, dtype=torch.float64)
        off = (fit.covariance @ (fit.jacobian.T @ readings)).abs()
        seen = fit.to_first_order(fit.projector, fit.projector.rest(readings))
        scatter = torch.sqrt(torch.diagonal(jackknife_covariance(seen, block)))
        by_noise.append(off < HALF_WIDTH_90 * sd)
        by_block.append(off < HALF_WIDTH_90 * torch.maximum(scatter, sd))
    assert (torch.stack(by_noise).double().mean(0) < 0.6).all()
    assert (torch.stack(by_block).double().mean(0) > 0.75).all()


def test_more_readings_make_nothing_surer_of_what_the_mixture_leaves_open(small_rig, small_session):
    """With ten times the variance of the fit of the search, in its principal axes as they are."""
    observations = small_session.observations
    searched, fitted_to_all = fit_of(small_rig, observations.calibration), fit_of(small_rig, observations)
    names, spread = searched.posterior.coordinates.names, 10.0 * searched.covariance
    for name, factor in Widening.of(searched, fitted_to_all, names, spread).factors.items():
        assert factor * fitted_to_all.value_sd(name) >= 0.99 * searched.value_sd(name, spread)
        assert factor > 1.0


def test_of_right_readings_little_is_made_less_sure_and_nothing_surer(of_nothing):
    plain, numbers = of_nothing.plain, Numbers.of(of_nothing)
    factors = Widening.of(plain, plain, numbers.names, numbers.about(plain)).factors
    assert set(factors) == {parameter.name for parameter in plain.rig.free}
    assert all(1.0 <= factor < 2.5 for factor in factors.values())


def test_what_is_open_of_some_numbers_opens_those_that_follow_them(small_rig, small_session):
    """A zero of the sensor is tied to the loops by the readings: it is as open as draws of these, each with the zero that fits them."""
    fit = fit_of(small_rig, small_session.observations, Cause("sensor_offset", "hall"))
    names = [p.name for p in small_rig.free]
    own, others = _rows(fit, names)
    wide = 9.0 * fit.covariance[own][:, own]
    slopes = torch.linalg.solve(fit.covariance[own][:, own], fit.covariance[own][:, others])
    spread = fit.covariance[others][:, others] + slopes.T @ (8.0 / 9.0 * wide) @ slopes
    widened = Widening.of(fit, fit, names, wide).covariance
    share = widened[others][:, others].diagonal() / spread.diagonal()
    assert (share > 0.97).all()  # priors may narrow it by some per cent
    assert float((spread.diagonal() / fit.covariance[others][:, others].diagonal()).max()) > 1.5
    same = Widening.of(fit, fit, names, fit.covariance[own][:, own]).covariance
    assert (widened[others][:, others].diagonal() > same[others][:, others].diagonal()).any()


def _rows(fit: Fit, names: list[str]) -> tuple[list[int], list[int]]:
    """Coordinates of some numbers, and the others."""
    of_fit = fit.posterior.coordinates.names
    own = [of_fit.index(name) for name in names]
    return own, [i for i in range(len(of_fit)) if i not in own]


def test_no_widening_says_less_than_the_priors_do_nor_more_than_the_fit(fit):
    prior_precision = (fit.optimum.precision - fit.optimum.information)[0]
    generator = torch.Generator().manual_seed(4)
    scale = fit.covariance.diagonal().sqrt()
    for size in (0.0, 3.0, 1e3):
        far = size * scale * torch.randn(2, len(scale), generator=generator, dtype=torch.float64)
        wide = envelope(fit.covariance, far.T @ far)
        within = within_prior(fit, wide)
        for more, unit in (
            (1.05 * torch.linalg.inv(within) - prior_precision, scale),
            (within - fit.covariance, 1.0 / scale),
        ):
            in_units = unit[:, None] * more * unit
            share = torch.linalg.eigvalsh(0.5 * (in_units + in_units.T))
            assert share.min() > -1e-6 * max(1.0, float(share.max()))
    torch.testing.assert_close(within_prior(fit, fit.covariance), fit.covariance, rtol=1e-8, atol=0.0)
    assert float((wide.diagonal() / within.diagonal()).max()) > 100.0


def test_a_number_that_the_fit_puts_far_from_its_prior_may_be_where_that_expects_it(fit, small_session):
    height = "coil1.world_from_coil0.z_m"
    expected = "z_mm: {prior: {normal: {mean: -32, sd: 1}}}"
    text = RIG.replace("z_mm: {prior: {normal: {mean: -40, sd: 3}}}", expected)
    pulled = fit_of(rig_from_text(text), small_session.observations)
    names = pulled.posterior.coordinates.names
    away_m = float(pulled.values[height]) + 0.032
    assert away_m < -4e-3
    wide = Widening.of(pulled, pulled, names, pulled.covariance)
    assert pulled.value_sd(height, wide.covariance) == pytest.approx(abs(away_m), rel=0.1)
    assert not back_to_priors(fit, fit.posterior.coordinates.names)


def test_envelope_is_in_no_direction_surer_than_either():
    """Also for numbers of very different size, and where one covariance leaves some of them open."""
    generator = torch.Generator().manual_seed(2)
    size = torch.tensor([1e-6, 1.0, 1e3, 1e-3], dtype=torch.float64)
    direction = torch.randn(500, 4, generator=generator, dtype=torch.float64) / size
    for rank in (2, 4, 9):
        first, second = (
            size[:, None] * draws.T @ draws * size
            for draws in (torch.randn(n, 4, generator=generator, dtype=torch.float64) for n in (9, rank))
        )
        variances = [((direction @ c) * direction).sum(1) for c in (first, second, envelope(first, second))]
        assert (variances[2] >= torch.maximum(variances[0], variances[1]) * (1.0 - 1e-9)).all()
        assert torch.allclose(envelope(first, 0.5 * first), first, rtol=1e-9)


def drawn(fit: Fit, factor: float) -> dict[str, np.ndarray]:
    """Draws of a widening by a factor of the standard deviations."""
    return Widening(fit, factor**2 * fit.covariance).drawn(32, 125, seed=1).draws


def test_draws_are_as_wide_as_the_widening_in_every_direction(fit):
    """Whole counts, which are coarse, take away or add a little."""
    wanted = 9.0 * fit.covariance
    draws = {name: torch.from_numpy(values.ravel()) for name, values in drawn(fit, 3.0).items()}
    vectors = fit.posterior.coordinates.vector(draws)
    share = torch.linalg.eigvals(torch.linalg.solve(wanted, vectors.T.cov())).real
    assert share == pytest.approx(1.0, abs=0.2)
    off = (vectors.mean(0) - fit.vector) / wanted.diagonal().sqrt()
    assert off.numpy() == pytest.approx(0.0, abs=0.1)


def test_the_density_of_draws_is_that_of_the_law_they_are_of(fit):
    """On average half the number of coordinates below its maximum, and as scattered."""
    density = Widening(fit, 9.0 * fit.covariance).drawn(32, 125, seed=1).log_prob
    n = len(fit.vector)
    assert density.shape == (32, 125)
    assert density.mean() == pytest.approx(-0.5 * n, rel=0.05)
    assert density.var() == pytest.approx(0.5 * n, rel=0.1)


def test_a_whole_count_has_the_probability_that_the_widening_gives_it(fit):
    """As where coils pull each other: a model that lacks it would be sure of one count."""
    counts = drawn(fit, 5.0)[COUNT].ravel()
    middle, sd = fit.values[COUNT], 5.0 * fit.value_sd(COUNT)
    whole = np.arange(1.0, 40.0)
    density = np.exp(-0.5 * ((whole - float(middle)) / sd) ** 2)
    for count, probability in zip(whole, density / density.sum(), strict=True):
        assert (counts == count).mean() == pytest.approx(probability, abs=0.05)
    assert (counts == counts.round()).all()
    assert len(np.unique(counts)) > 3


def test_no_draw_leaves_the_bounds_of_its_prior(rig_text, small_session, fit):
    most_mm = 1e3 * (float(fit.values[RADIUS]) + fit.value_sd(RADIUS))
    rig = rig_from_text(rig_text.replace("mean: 51, sd: 1}", f"mean: 51, sd: 1, upper: {most_mm}}}"))
    radii_m = drawn(fit_of(rig, small_session.observations), 10.0)[RADIUS]
    assert radii_m.max() == pytest.approx(1e-3 * most_mm, rel=1e-12)
    assert radii_m.max() <= 1e-3 * most_mm


def test_no_draw_is_impossible(fit, monkeypatch):
    """A winding whose mean square radius is negative has no radius."""
    as_they_are = Coordinates.values

    def without_a_radius(self: Coordinates, vector: torch.Tensor) -> dict[str, torch.Tensor]:
        values = as_they_are(self, vector)
        radius_m = values[RADIUS].clone()
        radius_m[:3] = torch.nan
        return {**values, RADIUS: radius_m}

    possible = drawn(fit, 10.0)[RADIUS].ravel()[3:]
    monkeypatch.setattr(widening, "with_whole_counts", lambda own, vectors, *_: own.values(vectors))
    monkeypatch.setattr(Coordinates, "values", without_a_radius)
    radii_m = drawn(fit, 10.0)[RADIUS].ravel()
    assert np.isfinite(radii_m).all()
    assert radii_m.std() == pytest.approx(possible.std(), rel=0.1)


def test_widening_is_nowhere_surer_than_readings_held_out_by_place_or_time_allow(small_rig, small_session):
    observations = small_session.observations
    hours = (observations.time_s - observations.time_s.min()) / 3600.0
    wave = 1.0 + 0.03 * torch.cos(3.0 * torch.pi * hours / hours.max())[:, None]
    fit = fit_of(small_rig, observations.with_field(wave * observations.field_sensor_T).calibration)
    wider = Widening.of(fit, fit, fit.posterior.coordinates.names, fit.covariance)
    scale = fit.covariance.diagonal().sqrt()
    for least in (
        fit.covariance,
        jackknife_covariance(fit, time_blocks(fit.observations)),
        jackknife_covariance(fit, pose_blocks(fit.observations, np.random.default_rng(0))),
    ):
        more = (wider.covariance - within_prior(fit, envelope(fit.covariance, least))) / (
            scale[:, None] * scale
        )
        assert torch.linalg.eigvalsh(0.5 * (more + more.T)).min() > -1e-6 * more.abs().max()
    assert max(wider.factors.values()) > 1.5


def test_directions_that_rounding_made_negative_do_not_stop_an_envelope():
    """Two zeros that readings cannot tell apart have a correlation so near to one that a Cholesky factorization fails."""
    covariance = torch.tensor([[1.0, 1.0 + 1e-11], [1.0 + 1e-11, 1.0]], dtype=torch.float64)
    assert float(torch.linalg.eigvalsh(covariance)[0]) < -LEAST_SHARE
    wider = envelope(covariance, torch.full((2, 2), 4.0, dtype=torch.float64))
    torch.testing.assert_close(wider, torch.full((2, 2), 4.0, dtype=torch.float64), atol=1e-5, rtol=0.0)


def test_envelope_of_many_keeps_the_digits_of_what_is_sure():
    """Two scatters that are huge in directions of which readings know nothing leave predictions as sure as their sum does."""
    generator = torch.Generator().manual_seed(3)
    readings = torch.randn(60, 12, generator=generator, dtype=torch.float64)
    readings[:, 6:] = (
        readings[:, :6] + 1e-3 * readings[:, 6:]
    )  # each number has a double that is nearly itself
    covariance = torch.linalg.inv(readings.T @ readings + 1e-8 * torch.eye(12, dtype=torch.float64))
    shifts = torch.randn(2, 5, 12, generator=generator, dtype=torch.float64)
    shifts[:, :, :6] *= 1e4
    shifts[:, :, 6:] -= shifts[:, :, :6]
    others = [shift.T @ shift for shift in shifts]

    def variance(of: torch.Tensor) -> torch.Tensor:
        return ((readings @ of) * readings).sum(1)

    each = torch.stack([variance(of) for of in (covariance, *others)])
    assert (variance(envelope(covariance, *others)) <= 1.01 * each.sum(0)).all()
    assert (variance(envelope(covariance, *others)) >= 0.99 * each.amax(0)).all()
