"""The schema allows what the reader takes, and refuses what a reader of keys refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from jsonschema import Draft202012Validator

from estimator.cli.main import main
from estimator.errors import InvalidInput
from estimator.rig_files.read import rig_from_text
from estimator.rig_files.schema import rig_schema
from estimator.yaml_loader import Loader
from tests.estimator.conftest import CORRECTION, RIG, TWO_COILS

CONFIGS = Path(__file__).parents[3] / "configs"
SHIPPED = sorted(path for path in CONFIGS.glob("*.yaml"))


@pytest.fixture(scope="module")
def schema() -> Draft202012Validator:
    Draft202012Validator.check_schema(rig_schema())
    return Draft202012Validator(rig_schema())


def data(text: str) -> object:
    return Loader(text, "rig").get_single_data()


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.name)
def test_shipped_files_are_allowed(schema, file):
    assert list(schema.iter_errors(data(file.read_text(encoding="utf-8")))) == []


@pytest.mark.parametrize(
    "text", [RIG, TWO_COILS, RIG + CORRECTION, RIG + "effects: {'axis_gain[hall]': {x: 0.01, y: 0, z: 0}}"]
)
def test_files_of_other_tests_are_allowed(schema, text):
    rig_from_text(text)
    assert list(schema.iter_errors(data(text))) == []


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("radius_mm:", "raduis_mm:"),
        ("radius_mm:", "radius_T:"),
        ("motion: displacement", "motion: sideways"),
        ("mean: 51", "middle: 51"),
        ("wire_radius_mm: 0.98", "wire_radius_mm: thin"),
        ("z_mm:", "z:"),
        ("schema_version: 1", "schema_version: 2"),
        ("  arm1:", "  arm 1:"),
    ],
)
def test_what_the_reader_refuses_is_refused(schema, right, wrong):
    text = RIG.replace(right, wrong, 1)
    assert text != RIG
    with pytest.raises(InvalidInput):
        rig_from_text(text)
    assert list(schema.iter_errors(data(text)))


def test_a_cause_that_nobody_knows_is_refused(schema):
    assert list(schema.iter_errors(data(RIG + "effects: {'axis_gian[hall]': {x: 0.01}}")))


def test_the_command_prints_it():
    result = CliRunner().invoke(main, ["schema", "rig"])
    assert json.loads(result.stdout) == rig_schema()
