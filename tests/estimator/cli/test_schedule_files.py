"""What cron, systemd and Kubernetes are given: calls that the command understands, folders that can be written, exit codes that are news."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from estimator.cli.output import EXIT_DRIFTED, EXIT_NOT_CONVERGED, EXIT_REJECTED
from estimator.cli.recalibrate import recalibrate_command
from tests.program import ROOT

CONFIGS = ROOT / "configs"
UNIT = CONFIGS / "systemd/coilcal-recalibrate.service"
DOCKERFILE = CONFIGS / "kubernetes/Dockerfile"


def settings(unit: Path) -> dict[str, list[str]]:
    """Values by key; a key may come several times."""
    found: dict[str, list[str]] = {}
    for line in unit.read_text(encoding="utf-8").splitlines():
        key, is_setting, value = line.partition("=")
        if is_setting and not line.startswith(("#", "[")):
            found.setdefault(key, []).append(value)
    return found


def job() -> dict[str, Any]:
    loaded: dict[str, Any] = yaml.safe_load((CONFIGS / "kubernetes/coilcal-recalibrate.yaml").read_text())
    return loaded["spec"]["jobTemplate"]["spec"]


def calls() -> dict[str, list[str]]:
    """The words of each call, from the command's name on."""
    cron = (CONFIGS / "cron/coilcal-recalibrate").read_text(encoding="utf-8").splitlines()[-1]
    container = job()["template"]["spec"]["containers"][0]
    found = {
        "cron": shlex.split(cron.split(maxsplit=6)[6]),
        "systemd": shlex.split(settings(UNIT)["ExecStart"][0]),
        "kubernetes": container["command"],
    }
    return {name: words[words.index("recalibrate") :] for name, words in found.items()}


@pytest.mark.parametrize("name", ["cron", "systemd", "kubernetes"])
def test_each_calls_the_command_with_all_that_it_needs_and_an_alert(name):
    command, *words = calls()[name]
    asked = recalibrate_command.make_context(command, words).params
    assert all(asked[key] is not None for key in ("rig_path", "inbox", "registry"))
    assert asked["alert_command"] or asked["alert_webhook"]


def test_systemd_makes_the_folders_that_are_written_and_all_else_is_read_only():
    unit = settings(UNIT)
    (registry,) = re.findall(r"--registry (\S+)", unit["ExecStart"][0])
    writable = (f"/var/lib/{unit['StateDirectory'][0]}/", f"/var/cache/{unit['CacheDirectory'][0]}/")
    caches = dict(word.split("=") for word in unit["Environment"][0].split())
    assert caches.keys() == {"MPLCONFIGDIR", "TORCHINDUCTOR_CACHE_DIR", "XDG_CACHE_HOME"}
    assert all(f"{path}/".startswith(writable) for path in (registry, *caches.values()))
    assert (unit["ProtectSystem"], unit["PrivateTmp"]) == (["strict"], ["yes"])
    assert unit["SuccessExitStatus"] == [f"{EXIT_DRIFTED} {EXIT_REJECTED}"]


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd here")
def test_systemd_finds_nothing_wrong_with_the_units(tmp_path):
    for path in (UNIT, UNIT.with_suffix(".timer")):
        text = path.read_text(encoding="utf-8").replace("/opt/coilcal/bin/coilcal", "/bin/true")
        (tmp_path / path.name).write_text(text.replace("User=coilcal", "User=root"), encoding="utf-8")
    verify = ["systemd-analyze", "verify", "--man=no", *sorted(map(str, tmp_path.iterdir()))]
    done = subprocess.run(verify, capture_output=True, text=True, check=False)
    assert (done.returncode, [line for line in done.stderr.splitlines() if str(tmp_path) in line]) == (0, [])


def test_kubernetes_tries_again_only_where_that_can_help():
    (rule,) = job()["podFailurePolicy"]["rules"]
    assert rule["action"] == "FailJob"
    assert rule["onExitCodes"]["values"] == sorted({EXIT_DRIFTED, EXIT_REJECTED, EXIT_NOT_CONVERGED})
    assert rule["onPodConditions"] == []  # which is asked for before 1.29
    assert job()["template"]["spec"]["restartPolicy"] == "Never"  # a failure policy needs it


def test_the_image_is_the_one_that_the_dockerfile_makes_of_this_version():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    image = job()["template"]["spec"]["containers"][0]["image"]
    text = DOCKERFILE.read_text(encoding="utf-8")
    assert image == f"coilcal:{version}"
    assert f"--tag {image} ." in text
    copied = [word for line in re.findall(r"^COPY (.*)", text, re.MULTILINE) for word in line.split()[:-1]]
    assert all((ROOT / name).exists() for name in copied)
    assert {"pyproject.toml", "constraints.txt", "README.md", "LICENSE", "estimator", "drivers"} <= set(
        copied
    )
    runs_as = job()["template"]["spec"]["securityContext"]
    assert f"USER {runs_as['runAsUser']}:{runs_as['runAsGroup']}" in text
