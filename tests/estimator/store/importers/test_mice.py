"""MICE maps, taken with six probes on a rotating disc, are converted to the frames of the rig."""

from __future__ import annotations

import math
import os
from pathlib import Path

import pytest
import torch

from estimator.errors import InvalidInput
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.rig import Rig
from estimator.rig_files.read import load_rig
from estimator.store.importers.common import map_observations
from estimator.store.importers.mice import read_mice

CONFIGS = Path(__file__).parents[4] / "configs"
HEADER = (
    "#z (m)\tr (m)\tphi (deg) \tBr (T)\tBphi (T)\tBz (T)\tB (T)\tprobeID\tDate (DDMMYYY)\tTime (24-HH:MM:SS)"
)
AZIMUTH_DEG = (0.0, 0.0, 90.0, 0.0, 270.0, 90.0)
INSTANTS = ((3.0, 20.0, 120), (3.2, 20.0, 50001), (3.2, 340.0, 120000))  # z, disc angle, HHMMSS


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(CONFIGS / "mice_ssu_m1.yaml")


def row(probe: int, z_m: float, disc_deg: float, time: int, field_T: tuple[float, float, float]) -> str:
    """A line of the source, from the components along the probe's axes."""
    r, phi_deg, (first, second, axial) = 0.03 * probe, (disc_deg + AZIMUTH_DEG[probe]) % 360.0, field_T
    if probe == 0:  # at r = 0 the file states phi = 0 and the components along x and y of the mapper
        turn = math.radians(disc_deg)
        first, second = (
            math.cos(turn) * first - math.sin(turn) * second,
            math.sin(turn) * first + math.cos(turn) * second,
        )
        phi_deg = 0.0
    norm = math.hypot(*field_T)
    numbers = "\t".join(f"{x:.10f}" for x in (z_m, r, phi_deg, first, second, axial, norm))
    return f"{numbers}\t{probe}\t1032018\t{time}"


def rows(field_T: tuple[float, float, float] = (1e-3, 2e-3, 0.3)) -> list[str]:
    return [row(probe, *instant, field_T) for instant in INSTANTS for probe in range(6)]


def written(folder: Path, lines: list[str]) -> Path:
    path = folder / "run.dat"
    path.write_text("\n".join([HEADER, *lines]) + "\n")
    return path


def values_of(rig: Rig) -> dict[str, torch.Tensor]:
    return {name: torch.tensor(v, dtype=torch.float64) for name, v in rig.nominal_values().items()}


def test_a_map_of_a_tilted_coil_is_predicted_exactly(tmp_path, rig):
    tilted = rig.with_values({"M1.world_from_coil.tilt_x_rad": 0.02, "M1.world_from_coil.x_m": 0.01})
    n = 6 * len(INSTANTS)
    pose = torch.zeros(n, 6, dtype=torch.float64)
    instants = torch.tensor(INSTANTS, dtype=torch.float64).repeat_interleave(6, dim=0)
    pose[:, 2], pose[:, 5] = instants[:, 0], torch.deg2rad(instants[:, 1])
    sensor = torch.arange(6).repeat(len(INSTANTS))
    no_field = torch.zeros(n, 3, dtype=torch.float64)
    truth = map_observations(tilted, [30.0], pose, no_field, time_s=pose[:, 0], sensor=sensor)
    field_T = MeasurementModel.build(tilted, truth).predict(values_of(tilted)).tolist()
    lines = [
        row(p, *instant, tuple(field_T[6 * i + p])) for i, instant in enumerate(INSTANTS) for p in range(6)
    ]
    read = read_mice(written(tmp_path, lines[::-1]), rig).observations
    predicted = MeasurementModel.build(tilted, read).predict(values_of(tilted))
    torch.testing.assert_close(
        read.field_sensor_T, predicted, rtol=0.0, atol=2e-9
    )  # the file has 10 decimals
    assert predicted[read.sensor == 0, :2].abs().max() > 1e-4


def test_rows_are_sorted_by_a_time_without_leading_zeros(tmp_path, rig):
    o = read_mice(written(tmp_path, rows()[::-1]), rig).observations
    assert o.time_s[::6].tolist() == [0.0, 17_921.0, 43_120.0]  # 00:01:20, 05:00:01, 12:00:00
    assert o.sensor.tolist() == list(range(6)) * 3
    torch.testing.assert_close(
        o.motion["mapper"][::6, 5], torch.deg2rad(torch.tensor([20, 20, 340]).double())
    )


def test_every_coil_carries_30_ampere_unless_given(tmp_path, rig):
    path = written(tmp_path, rows())
    assert read_mice(path, rig).observations.current_A.unique().tolist() == [30.0]
    assert read_mice(path, rig, {"M1": 0.0}).observations.current_A.unique().tolist() == [0.0]
    with pytest.raises(InvalidInput, match=r"currents must be given for each coil .* \(M1\); received M2"):
        read_mice(path, rig, {"M2": 30.0})


def test_on_the_axis_alone_only_the_axial_component_is_known(tmp_path, rig):
    o = read_mice(written(tmp_path, [row(0, 3.0, 20.0, 120000, (1e-3, 2e-3, 0.3))]), rig).observations
    assert o.is_measured.tolist() == [[False, False, True]]
    assert o.motion["mapper"].tolist() == [[0.0, 0.0, 3.0, 0.0, 0.0, 0.0]]


@pytest.mark.parametrize(
    ("find", "replace", "message"),
    [
        ("0.0300000000", "0.0320000000", "probe1 must be at r = 0.03 m"),
        ("110.0000000000", "112.0000000000", "probe2 must be at the azimuth .* 2 deg off"),
        ("\t5\t1032018", "\t6\t1032018", r"probes must be sensors of rig .* received probe6"),
        ("\t50001", "\t246060", "date and time must read DDMMYYYY HHMMSS; received '01032018 246060'"),
        ("0.3000000000", "x", "cell 6 must be a finite number; received 'x' .*line 2"),
        ("\tprobeID", "", "must begin with a # line"),
        ("0.3000000000\t", "", "must have 10 columns; it has 9"),
    ],
)
def test_a_file_that_does_not_fit_the_rig_is_refused(tmp_path, rig, find, replace, message):
    path = written(tmp_path, rows())
    assert find in path.read_text()
    path.write_text(path.read_text().replace(find, replace))
    with pytest.raises(InvalidInput, match=message):
        read_mice(path, rig)


@pytest.fixture(scope="module")
def run07() -> Path:
    if "COILCAL_DATA" not in os.environ:
        pytest.skip("COILCAL_DATA does not name the folder of measured maps")
    return Path(os.environ["COILCAL_DATA"]) / "mice-ssu-solenoids" / "run07_polarCoordinates.dat"


def test_the_winding_as_built_predicts_run_07_within_1_06_mT(run07, rig):
    o = read_mice(run07, rig).observations
    with torch.no_grad():
        residual_T = o.field_sensor_T - MeasurementModel.build(rig, o).predict(values_of(rig))
    assert len(o) == 11_514
    assert o.is_measured.all()
    vector_rms_T = residual_T.square().sum(-1).mean().sqrt().item()
    assert vector_rms_T == pytest.approx(1.056e-3, abs=2e-6)


def test_far_from_the_coil_the_probe_on_the_axis_shows_an_offset_fixed_to_the_disc(run07, rig):
    o = read_mice(run07, rig).observations
    far = (o.sensor == 0) & (o.motion["mapper"][:, 2] < 2.0)
    transverse_T = o.field_sensor_T[far, :2]
    assert transverse_T.mean(0).norm() > 5e-4
    assert transverse_T.std(0).max() < 6e-5  # in the frame of the file it turns with the disc: 4e-4
