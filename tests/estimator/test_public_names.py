"""The names that other people's scripts import, pinned; and that everything public says what it is for."""

from __future__ import annotations

import ast
import importlib
import inspect
import os
import pkgutil
from pathlib import Path
from types import ModuleType

import pytest
import torch

import coilcal
import estimator
from tests.program import PYTHON, finished

NAMES = [
    "Calibration",
    "CoilcalError",
    "CorruptStore",
    "Design",
    "Diagnosis",
    "Entry",
    "Estimate",
    "InvalidInput",
    "NextStop",
    "Observations",
    "Plan",
    "Planned",
    "Registry",
    "Rig",
    "SamplerSettings",
    "Session",
    "Stage",
    "Stream",
    "Superposition",
    "System",
    "SystemField",
    "batch",
    "block_split",
    "calibrate",
    "design",
    "diagnose",
    "draw_truth",
    "load_plan",
    "load_rig",
    "load_session",
    "next_stop",
    "plan",
    "recalibrate",
    "register_effect",
    "roll_back",
    "simulate",
    "superposition",
]
SIGNATURES = {
    "calibrate": "session, rig, out, overwrite, seed, settings, has_integer_counts, as_described, near, device, precision, on_stage",
    "recalibrate": "rig, inbox, registry, seed, settings, again, on_entry, on_waiting, watcher",
    "batch": "sessions, out, rig, columns, hypotheses, is_each_coil, has_posterior, seed, settings, workers, scheduler, device, precision, as_described, tell",
    "roll_back": "registry, version",
    "next_stop": "rig, places, goals, readings, pace, most_stops, seed",
    "plan": "rig, places, goals, n_stops, pace, order, seed, on_count",
    "simulate": "rig, plan, truth, seed, hidden, n_segments",
    "draw_truth": "rig, seed",
    "load_plan": "path, rig",
    "load_rig": "path",
    "load_session": "path",
    "block_split": "observations, share, seed",
    "Calibration.field": "self, points_m, currents_A, motion",
    "Calibration.gradient": "self, points_m, currents_A, motion",
    "Calibration.field_interval": "self, points_m, currents_A, level, motion",
    "Calibration.coils_alone": "self",
    "Calibration.summary": "self",
    "Calibration.save": "self, folder",
    "Calibration.load": "folder",
    "superposition": "system, session, seed, on_stage",
    "System.of": "calibrations",
    "System.at": "self, points_m, motion",
    "System.currents": "self, currents_A",
    "SystemField.field_T": "self, current_A",
    "SystemField.gradient_T_per_m": "self, current_A",
    "SystemField.field_interval_T": "self, current_A, level",
    "SystemField.gradient_interval_T_per_m": "self, current_A, level",
    "SystemField.force_N": "self, moment_A_m2, current_A",
    "SystemField.actuation": "self, has_gradient",
    "SystemField.currents_for_field": "self, field_T, most_A",
    "SystemField.currents_for_force": "self, moment_A_m2, force_N, most_A",
    "Session.save": "self, path, overwrite",
}
MODULES = sorted(
    module.name
    for module in pkgutil.walk_packages(estimator.__path__, "estimator.")
    if module.name != "estimator.cli.main"
)


def test_the_public_names_are_these():
    assert sorted(estimator.__all__) == NAMES
    assert list(estimator.__all__) == NAMES
    assert all(hasattr(estimator, name) for name in NAMES)


def test_the_distribution_has_them_under_its_own_name():
    assert dir(coilcal) == NAMES
    assert all(getattr(coilcal, name) is getattr(estimator, name) for name in NAMES)
    with pytest.raises(AttributeError, match="no attribute 'callibrate'"):
        coilcal.callibrate  # noqa: B018


@pytest.mark.parametrize("name", coilcal.PACKAGES)
def test_a_package_of_another_distribution_is_not_run(tmp_path, name):
    (tmp_path / name).mkdir()
    (tmp_path / name / "__init__.py").write_text('"""Something else."""\n', encoding="utf-8")
    path = os.pathsep.join([str(tmp_path), str(Path(coilcal.__file__).parents[1])])
    environment = {**os.environ, "PYTHONPATH": path}
    ran = finished(PYTHON, "-m", "coilcal", "--version", cwd=tmp_path, env=environment)
    assert ran.returncode == 2
    assert ran.stderr.startswith(f"coilcal: package {name!r} must be that of coilcal; ")
    assert ran.stderr.count("\n") == 1


def test_type_checkers_see_the_names_that_are_loaded_when_used():
    """The stub and where each name is loaded from say the same."""
    tree = ast.parse(Path(estimator.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    seen = {
        alias.asname: node.module for node in imports for alias in node.names if alias.name == alias.asname
    }
    assert seen == estimator._MODULES
    assert sorted(seen) == NAMES


def test_names_are_listed_before_they_are_loaded_and_others_are_refused():
    assert set(NAMES) <= set(dir(estimator))
    with pytest.raises(AttributeError, match="module 'estimator' has no attribute 'callibrate'"):
        estimator.callibrate  # noqa: B018


def test_public_calls_take_these_arguments():
    for name, parameters in SIGNATURES.items():
        member: object = estimator
        for part in name.split("."):
            member = getattr(member, part)
        assert ", ".join(inspect.signature(member).parameters) == parameters  # type: ignore[arg-type]


def public_members(module: ModuleType) -> list[tuple[str, object]]:
    """Functions and classes that a module defines, and what the classes define."""
    own = [
        (name, member)
        for name, member in vars(module).items()
        if not name.startswith("_")
        and (inspect.isfunction(member) or inspect.isclass(member))
        and member.__module__ == module.__name__
    ]
    methods = [
        (f"{name}.{key}", value)
        for name, cls in own
        if inspect.isclass(cls)
        for key, value in vars(cls).items()
        if not key.startswith("_")
        and (inspect.isfunction(value) or isinstance(value, property | classmethod))
    ]
    return own + methods


def test_every_public_function_and_class_has_a_docstring():
    for name in MODULES:
        module = importlib.import_module(name)
        assert module.__doc__, name
        elsewhere = {"Normal", "LogNormal", "Uniform"}  # documented once, in Prior
        if name.startswith("estimator.numpy_tensors"):  # names and meaning are those of torch
            elsewhere |= {member for member, _ in public_members(module) if hasattr(torch, member)}
            elsewhere |= {"Arithmetic", "Tensor"}
        undocumented = [
            member
            for member, value in public_members(module)
            if member.partition(".")[0] not in elsewhere and not is_documented(value)
        ]
        assert not undocumented, name


def is_documented(value: object) -> bool:
    """Whether a person wrote a docstring; a dataclass without one gets its signature for a docstring."""
    text = inspect.getdoc(value) or ""
    return bool(text) and not text.startswith(f"{getattr(value, '__name__', '?')}(")
