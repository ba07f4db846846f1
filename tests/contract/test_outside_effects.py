"""A package outside the repository declares one cause per stage: each is simulated, found, named, kept in a rig file, sampled and predicted."""

from __future__ import annotations

import html
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from estimator import Session, diagnose, load_plan, load_rig, simulate
from estimator.effects import EFFECTS, ORDER, register_effect
from estimator.effects.base import Effect, normal
from estimator.effects.stages import CurrentEffect
from estimator.errors import InvalidInput
from tests.contract.outside import lab_effects
from tests.program import PYTHON, finished

OUTSIDE = Path(__file__).parent / "outside"
RIG = """
schema_version: 1
name: laboratory
movers: {mapper: {motion: pose}}
coils:
  coil1:
    radius_mm: {prior: {normal: {mean: 48, sd: 0.5}}}
    wire_radius_mm: 0.49
    axial_loops: 48
    radial_loops: 25
    world_from_coil:
      x_mm: {prior: {normal: {mean: 0, sd: 0.5}}}
      z_mm: {prior: {normal: {mean: -40, sd: 0.5}}}
      tilt_y_deg: {prior: {normal: {mean: 0, sd: 0.5}}}
sensors:
  hall: {carried_by: mapper, noise_uT: {prior: {log_normal: {median: 10, relative_sd: 0.3}}}}
"""
PLAN = """
schema_version: 1
name: scattered
poses:
  calibration:
    scattered: 30
    mapper: {x_mm: {from: -50, to: 50}, y_mm: {from: -50, to: 50}, z_mm: {from: -25, to: 25}}
  validation:
    scattered: 10
    mapper: {x_mm: {from: -45, to: 45}, y_mm: {from: -45, to: 45}, z_mm: {from: -22, to: 22}}
largest_A: {coil1: 3}
settle_s: 5
"""
TRUTH = {"coil1.radius_m": 0.0483}
HIDDEN = {  # all show clearly, the least by 11 standard deviations
    "dead_band.width_A": 0.05,
    "swollen_wire.excess": 0.1,
    "iron_beside.share": 0.05,
    "field_gradient.vertical_T_per_m": 1.5e-3,
    "arm_sag.curvature_per_m": 0.08,
    "holder_creep.rate_m_per_h": 1.4e-3,
    "element_ring.radius_m": 4e-4,
    "ferrite_bead.share": 0.05,
    "quadratic_response.excess_per_T": 3.0,
    "noisy_axis.extra_T": 6e-5,
    "peak_to_peak_current.factor": 2.0,
}
DECLARED = [
    value() if isinstance(value, type) else value
    for value in vars(lab_effects).values()
    if isinstance(value, Effect)
    or (isinstance(value, type) and issubclass(value, Effect) and hasattr(value, "name"))
]
QUICK = ("field_gradient.vertical_T_per_m",)
MAKES_FIELD = ("dead_band", "swollen_wire", "iron_beside", "field_gradient")


@pytest.fixture
def files(tmp_path: Path) -> Path:
    (tmp_path / "rig.yaml").write_text(RIG, encoding="utf-8")
    (tmp_path / "plan.yaml").write_text(PLAN, encoding="utf-8")
    return tmp_path


@pytest.fixture
def registered() -> Iterator[None]:
    """The outside effects in this process, until the test ends."""
    known = dict(EFFECTS), dict(ORDER)
    for effect in DECLARED:
        register_effect(effect)
    yield
    for registry, before in zip((EFFECTS, ORDER), known, strict=True):
        registry.clear()
        registry.update(before)


@pytest.mark.whole
@pytest.mark.usefixtures("registered")
@pytest.mark.parametrize(
    "hidden", [pytest.param(key, marks=() if key in QUICK else pytest.mark.slow) for key in HIDDEN]
)
def test_an_outside_cause_is_hidden_and_named(files, hidden):
    rig = load_rig(files / "rig.yaml")
    readings = simulate(
        rig, load_plan(files / "plan.yaml", rig), TRUTH, seed=3, hidden={hidden: HIDDEN[hidden]}
    )
    diagnosis = diagnose(Session(rig, readings, source="simulated"), out=files / "diagnosis", seed=1)
    name, key = hidden.split(".")
    mistakes = [mistake.cause.name for mistake in diagnosis.record_mistakes]
    assert [*mistakes, *(cause.cause.name for cause in diagnosis.causes)] == [name]
    extended = load_rig(files / "diagnosis" / "rig_extended.yaml")
    (cause,) = extended.effects
    assert extended.nominal_values()[f"{cause.label}.{key}"] == pytest.approx(HIDDEN[hidden], rel=0.35)
    if name in MAKES_FIELD:
        point_m = torch.tensor([[0.02, 0.01, 0.01]], dtype=torch.float64)
        fields = [field_of(r, point_m) for r in (extended, extended.without_cause(cause))]
        assert float((fields[0] - fields[1]).norm()) > 1e-6


def field_of(rig, point_m):
    """What a prediction at the nominal values of a rig gives at 3 A."""
    from estimator.model.room_field import RoomField
    from estimator.rig.coordinates import nominal_tensors

    values = nominal_tensors(rig)
    return RoomField(rig, values, point_m).field_T(values, torch.tensor([3.0], dtype=torch.float64))


def test_every_stage_has_an_outside_effect():
    """A stage that is added to the contract needs a line here."""
    stages = {stage for stage in Effect.__subclasses__() if stage.__module__ == "estimator.effects.stages"}
    used = {stage for stage in stages if any(isinstance(effect, stage) for effect in DECLARED)}
    inside = {
        "WindingMagnetisation",
        "CoreMagnetisation",
        "CoreMemory",
        "SidesEffect",
    }  # of superconductors, of iron cores, and of windings with straight sides
    assert {stage.__name__ for stage in stages - used} == inside


def installed(folder: Path) -> dict[str, str]:
    """Environment in which the outside package is installed: its module, and the metadata that names its entry points."""
    site = folder / "site"
    info = site / "lab_effects-1.0.dist-info"
    info.mkdir(parents=True)
    shutil.copy(OUTSIDE / "lab_effects.py", site)
    shutil.copy(OUTSIDE / "entry_points.txt", info)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-effects\nVersion: 1.0\n")
    return {**os.environ, "PYTHONPATH": os.pathsep.join((str(site), str(Path(__file__).parents[2])))}


def coilcal(environment: dict[str, str], folder: Path, *arguments: str) -> str:
    program = "from estimator.cli.main import main; main(prog_name='coilcal')"
    command = [sys.executable, "-c", program, *arguments]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.whole
@pytest.mark.slow
@pytest.mark.parametrize("hidden", HIDDEN)
def test_commands_know_the_causes_of_an_installed_package(files, hidden):
    """From the simulation to a predicted field, each command in a process of its own."""
    environment, name = installed(files), hidden.partition(".")[0]
    simulation = (
        "simulate",
        "--rig",
        "rig.yaml",
        "--plan",
        "plan.yaml",
        "--seed",
        "3",
        "--out",
        "flawed.zarr",
    )
    coilcal(environment, files, *simulation, "--hide", f"{hidden}={HIDDEN[hidden]}")
    said = coilcal(environment, files, "diagnose", "flawed.zarr", "--out", "diagnosis", "--seed", "1")
    verdict, sentence = said.splitlines()[:2]
    assert verdict in ("verdict: named", "verdict: indistinguishable")  # another cause may look the same
    likeliest = re.search(r"\((\w+)", sentence)
    assert likeliest is not None
    assert likeliest[1] == name
    summary = json.loads((files / "diagnosis" / "calibration" / "summary.json").read_text())
    sampled = [parameter for parameter in summary["parameters"] if parameter.startswith(f"{name}[")]
    is_set = name == "peak_to_peak_current"  # it is there or not; nothing is sampled
    assert bool(sampled) != is_set
    report = html.unescape((files / "diagnosis" / "report.html").read_text(encoding="utf-8"))
    assert EXPLANATION[name][1:] in report  # a sentence may begin with it
    grid = ("--grid", "x_mm=0:20:3", "--grid", "y_mm=0", "--grid", "z_mm=0", "--current", "coil1=3")
    coilcal(environment, files, "predict", "diagnosis/calibration", *grid, "--out", "field.csv")
    assert len((files / "field.csv").read_text().splitlines()) > 3


EXPLANATION = {effect.name: effect.words for effect in DECLARED}


class _WithoutUnit(CurrentEffect):
    name, kind, words, source = "without_unit", "coil", "a current", "nowhere"

    def quantities(self, extent):
        return (normal("width", "A", 0.05),)

    def apply(self, current_A, theta, circumstances, coil):
        return current_A


def test_an_effect_that_breaks_the_contract_is_refused_in_one_sentence():
    with pytest.raises(InvalidInput, match="must be an instance of a stage"):
        register_effect(object())
    with pytest.raises(InvalidInput, match="must end in its unit A; received 'width'"):
        register_effect(_WithoutUnit())
    assert "without_unit" not in EFFECTS


def test_a_package_that_does_not_load_is_named(tmp_path):
    environment = installed(tmp_path)
    (tmp_path / "site" / "lab_effects.py").write_text("import nothing_of_that_name\n")
    done = finished(PYTHON, "-c", "import estimator.effects", env=environment)
    assert "plug-in 'dead_band' of coilcal.effects must load (lab_effects:dead_band)" in done.stderr
