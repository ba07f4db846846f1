"""Points in the kinds that users have, and answers in the same; what cannot be points is refused with what to pass."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import xarray as xr

from estimator import calibrate, diagnose
from estimator.calibration.result import Calibration
from estimator.errors import InvalidInput
from estimator.points import given_points
from estimator.system.system import System

ROWS = [[0.0, 0.0, 0.05], [0.01, 0.0, 0.06]]
ON = {"coil1": 2.0}
STILL = {"arm1": [0.0] * 6}


@pytest.fixture(scope="module")
def expected_T(small_calibration: Calibration) -> np.ndarray:
    points_m = torch.tensor(ROWS, dtype=torch.float64)
    return small_calibration.field(points_m, ON, STILL).numpy()


def test_points_of_a_data_frame_may_be_read_only():
    """Torch would warn of them, and warnings are errors here."""
    rows = np.asarray(ROWS)
    rows.flags.writeable = False
    assert given_points(rows).points_m.tolist() == ROWS


@pytest.mark.parametrize(
    "kind",
    [list, np.asarray, torch.tensor, lambda rows: tuple(map(tuple, rows)), np.float32],
    ids=["list", "array", "tensor", "tuple", "single"],
)
def test_answers_are_of_the_kind_that_was_given(kind, small_calibration, expected_T):
    many, alone = kind(ROWS), kind(ROWS)[1]
    for points, rows in ((many, expected_T), (alone, expected_T[1])):
        field_T = small_calibration.field(points, ON, STILL)
        assert type(field_T) is type(points)
        np.testing.assert_allclose(np.asarray(field_T), rows, rtol=1e-5)
        gradient = small_calibration.gradient(points, ON, STILL)
        assert np.shape(gradient) == (*rows.shape, 3)
        lower, upper = small_calibration.field_interval(points, ON, motion=STILL)
        assert type(lower) is type(points)
        assert (np.asarray(lower) <= np.asarray(upper)).all()
        assert np.shape(small_calibration.gradient_interval(points, ON, motion=STILL)[1]) == np.shape(
            gradient
        )


def test_tensors_keep_their_precision_and_their_derivatives(small_calibration):
    point_m = torch.tensor(ROWS[0], dtype=torch.float64, requires_grad=True)
    field_T = small_calibration.field(point_m, ON, STILL)
    (slope,) = torch.autograd.grad(field_T[2], point_m)
    np.testing.assert_allclose(
        slope.numpy(), np.asarray(small_calibration.gradient(ROWS[0], ON, STILL))[2], rtol=1e-6, atol=1e-9
    )
    assert small_calibration.field(torch.tensor(ROWS), ON, STILL).dtype is torch.float32


def test_labelled_points_are_answered_with_labels_and_units(small_calibration, expected_T):
    rows = xr.DataArray(
        np.array(ROWS).T, dims=("axis", "stop"), coords={"axis": ["x", "y", "z"], "stop": [7, 8]}
    )
    field_T = small_calibration.field(rows, ON, STILL)
    assert field_T.dims == ("stop", "component")
    assert (field_T.attrs["units"], list(field_T.component.values)) == ("T", ["x", "y", "z"])
    np.testing.assert_array_equal(field_T.sel(component="z", stop=8), expected_T[1, 2])
    gradient = small_calibration.gradient(rows.isel(stop=0), ON, STILL)
    assert (gradient.dims, gradient.attrs["units"]) == (("component", "direction"), "T/m")
    unnamed = small_calibration.field(xr.DataArray(np.array(ROWS), dims=("i", "j")), ON, STILL)
    assert unnamed.dims == ("i", "component")


@pytest.mark.parametrize("kind", [list, np.asarray, torch.tensor, xr.DataArray])
def test_a_system_answers_in_the_kind_of_its_points_whatever_else_is_given(
    kind, small_calibration, expected_T
):
    system = System.of(small_calibration)
    for points, rows in ((kind(ROWS), expected_T), (kind(ROWS)[1], expected_T[1])):
        here = system.at(points, STILL)
        assert type(here.actuation()) is type(points)
        for currents in (ON, [2.0], np.array([2.0]), system.currents(ON)):
            field_T = here.field_T(currents)
            assert type(field_T) is type(points)
            np.testing.assert_allclose(np.asarray(field_T), rows, rtol=1e-5)
        lower, upper = here.gradient_interval_T_per_m([[2.0], [1.0]])
        assert type(upper) is type(lower) is type(points)
        assert np.shape(upper) == (2, *rows.shape, 3)
        wanted_A = here.currents_for_field(here.field_T([1.5]), most_A=np.float64(5.0))
        np.testing.assert_allclose(np.asarray(wanted_A)[..., 0], 1.5, rtol=1e-5)
        moment, force_N = [0.0, 0.0, 1.0], here.force_N([0.0, 0.0, 1.0], [2.0])
        np.testing.assert_allclose(
            np.asarray(here.currents_for_force(moment, force_N))[..., 0], 2.0, rtol=1e-4
        )


def test_a_system_labels_what_it_answers(small_calibration):
    rows = xr.DataArray(np.array(ROWS), dims=("stop", "axis"), coords={"stop": [7, 8]})
    here = System.of(small_calibration).at(rows, STILL)
    matrix = here.actuation()
    assert (matrix.dims, list(matrix.coil.values)) == (("stop", "row", "coil"), ["coil1"])
    field_T = here.field_T([[1.0], [2.0]])
    np.testing.assert_allclose(
        matrix.sel(row="Bz", coil="coil1"), field_T.sel(batch0=0, component="z"), rtol=1e-9
    )
    assert here.currents_for_field(field_T).dims == ("batch0", "stop", "coil")


@pytest.mark.parametrize("currents", [[1.0, 2.0], 3.0, "on"])
def test_currents_that_are_not_one_for_each_coil_are_refused(currents, small_calibration):
    here = System.of(small_calibration).at(ROWS, STILL)
    with pytest.raises(InvalidInput, match=r"a number for each coil \(coil1\), or given by coil"):
        here.field_T(currents)


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (3.0, "three coordinates each, such as"),
        ([[1.0, 2.0]], "received shape (1, 2)"),
        ("here", "points must be numbers, such as [0.0, 0.0, 0.05]"),
        ([[0, 0, 1], [0, 1]], "points must be numbers"),
        (xr.DataArray(np.zeros((3, 3)), dims=("a", "b")), "one dimension with the coordinates x, y, z"),
        (xr.DataArray(np.zeros(4), dims="a"), "received dimensions {'a': 4}"),
    ],
)
def test_what_cannot_be_points_is_refused_with_what_to_pass(points, words):
    with pytest.raises(InvalidInput) as refusal:
        given_points(points)
    assert words in str(refusal.value)


@pytest.mark.whole  # with checks of types these calls end earlier
def test_currents_and_motions_of_another_kind_are_refused_with_what_to_pass(small_calibration):
    for currents, motion, words in (
        (2.0, None, "currents must be given by coil, such as {'coil1': 2.0}; received 2.0"),
        (
            {"coil1": [2.0]},
            None,
            "current of coil1 must be a number between -1e+12 and 1e+12; received [2.0]",
        ),
        ({"coil1": "2"}, None, "current of coil1 must be a number between -1e+12 and 1e+12; received '2'"),
        (ON, [0.0] * 6, "motion must be given by mover, such as {'arm1': [0, 0, 0.01, 0, 0, 0]}"),
        (ON, {"arm1": "home"}, "motion of arm1 must be six numbers, such as"),
        (ON, {"arm1": 0.0}, "motion of arm1 must be six numbers"),
    ):
        with pytest.raises(InvalidInput) as refusal:
            small_calibration.field(ROWS, currents, motion)  # type: ignore[arg-type]
        assert words in str(refusal.value)


def test_a_system_is_shown_in_a_few_lines(small_calibration):
    system = System.of(small_calibration)
    assert repr(system).startswith("System of 1 coil in one room.")
    assert len(repr(system).splitlines()) == 3
    assert "<td>coil1</td>" in system._repr_html_()


@pytest.mark.whole  # with checks of types these calls end earlier
def test_a_path_is_no_session():
    for work in (calibrate, diagnose):
        with pytest.raises(InvalidInput, match="session must be a Session, as load_session"):
            work("session.zarr")  # type: ignore[arg-type]
