"""What systemd and Kubernetes are given to serve: settings that load, calls that the command understands, folders that can be written."""

from __future__ import annotations

import shlex
import shutil
import subprocess
import tomllib
from typing import Any

import pytest
import yaml
from starlette.testclient import TestClient

from estimator.cli.serve import serve_group
from estimator.errors import InvalidInput
from estimator.service import serve
from estimator.service.app import create_app
from estimator.service.dispatcher import END_S
from estimator.service.guard import PUBLIC
from estimator.service.settings import ENVIRONMENT, KEYS, Settings, load_settings
from estimator.service.tokens import Scope, create_token
from tests.estimator.cli.test_schedule_files import CONFIGS, settings
from tests.estimator.service.conftest import refusal
from tests.program import ROOT

SERVE, BACKUP = (CONFIGS / f"systemd/coilcal-{name}.service" for name in ("serve", "backup"))
OPTIONS = {option for parameter in serve_group.params for option in parameter.opts}


def pod() -> dict[str, Any]:
    deployment, _ = yaml.safe_load_all(
        (CONFIGS / "kubernetes/coilcal-serve.yaml").read_text(encoding="utf-8")
    )
    assert deployment["spec"]["replicas"] == 1
    assert deployment["spec"]["strategy"] == {"type": "Recreate"}
    return dict(deployment["spec"]["template"]["spec"])


def test_the_settings_of_the_example_load_and_need_tokens():
    example = load_settings(CONFIGS / "service/service.yaml", {})
    assert example.needs_tokens
    assert example.is_loopback
    state = settings(SERVE)["StateDirectory"]
    assert str(example.data).startswith(f"/var/lib/{state[0]}/")


def test_systemd_serves_with_those_settings_and_backs_up_the_same_folder():
    words = shlex.split(settings(SERVE)["ExecStart"][0])
    assert words[1] == "serve"
    assert [word for word in words if word.startswith("--")] == ["--config"]
    assert set(words) & OPTIONS == {"--config"}
    config = words[words.index("--config") + 1]
    shell = settings(BACKUP)["ExecStart"][0]
    assert f"coilcal serve backup --config {config} /var/backups/coilcal/" in shell
    assert {"backup", "restore"} <= serve_group.commands.keys()
    assert settings(BACKUP)["ReadWritePaths"] == ["/var/backups/coilcal"]
    for unit in (SERVE, BACKUP):
        caches = dict(word.split("=") for word in settings(unit)["Environment"][0].split())
        assert all(path.startswith("/var/cache/coilcal") for path in caches.values())
        assert settings(unit)["ProtectSystem"] == ["strict"]


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd here")
def test_systemd_finds_nothing_wrong_with_the_units(tmp_path):
    for path in (SERVE, BACKUP, BACKUP.with_suffix(".timer")):
        text = path.read_text(encoding="utf-8").replace("/opt/coilcal/bin/coilcal", "/bin/true")
        (tmp_path / path.name).write_text(text.replace("User=coilcal", "User=root"), encoding="utf-8")
    verify = ["systemd-analyze", "verify", "--man=no", *sorted(map(str, tmp_path.iterdir()))]
    done = subprocess.run(verify, capture_output=True, text=True, check=False)
    assert (done.returncode, [line for line in done.stderr.splitlines() if str(tmp_path) in line]) == (0, [])


def test_kubernetes_runs_the_same_command_of_the_same_image_with_settings_that_are_known():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    (container,) = pod()["containers"]
    (first,) = pod()["initContainers"]
    assert container["command"] == ["coilcal", "serve"]
    assert container["image"] == first["image"] == f"coilcal:{version}"
    environment = {entry["name"]: entry["value"] for entry in container["env"]}
    assert all(name.startswith(ENVIRONMENT) for name in environment)
    loaded = load_settings(None, environment)
    assert len([key for key in KEYS if getattr(loaded, key) != getattr(Settings(), key)]) == len(environment)
    assert loaded.needs_tokens
    mounted = [mount["mountPath"] for mount in container["volumeMounts"]]
    assert str(loaded.data).startswith(mounted[0] + "/")
    for probe in ("startupProbe", "livenessProbe", "readinessProbe"):
        assert container[probe]["httpGet"]["path"] in PUBLIC
    assert container["ports"][0]["containerPort"] == loaded.port
    dockerfile = (CONFIGS / "kubernetes/Dockerfile").read_text(encoding="utf-8")
    assert "'.[service]'" in dockerfile
    assert f"EXPOSE {loaded.port}" in dockerfile


def test_names_in_the_manifest_are_those_of_things_that_are_there():
    deployment, service = yaml.safe_load_all(
        (CONFIGS / "kubernetes/coilcal-serve.yaml").read_text(encoding="utf-8")
    )
    spec, (container,), (first,) = pod(), pod()["containers"], pod()["initContainers"]
    labels = deployment["spec"]["template"]["metadata"]["labels"]
    assert deployment["spec"]["selector"]["matchLabels"] == service["spec"]["selector"] == labels
    ports = {port["name"] for port in container["ports"]}
    assert {port["targetPort"] for port in service["spec"]["ports"]} <= ports
    assert {probe["httpGet"]["port"] for key, probe in container.items() if key.endswith("Probe")} <= ports
    volumes = {volume["name"] for volume in spec["volumes"]}
    for each in (container, first):
        assert {mount["name"] for mount in each["volumeMounts"]} == volumes
        assert each["securityContext"]["readOnlyRootFilesystem"]  # so what is written is mounted:
        assert {"/tmp", "/var/cache/coilcal"} <= {mount["mountPath"] for mount in each["volumeMounts"]}
    assert spec["terminationGracePeriodSeconds"] > serve.GRACE_S + END_S
    words = shlex.split(first["command"][2])
    create = serve_group.commands["token"].commands["create"]
    options = {option for parameter in create.params for option in parameter.opts} | OPTIONS
    assert {word for word in words if word.startswith("--")} <= options
    assert words[words.index("--scope") + 1] in set(Scope)


def test_the_image_is_made_of_files_that_are_there_and_runs_as_the_user_of_the_pod():
    dockerfile = (CONFIGS / "kubernetes/Dockerfile").read_text(encoding="utf-8")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    lines = [shlex.split(line, comments=True) for line in dockerfile.splitlines()]
    copied = {word for line in lines if line[:1] == ["COPY"] for word in line[1:-1]}
    assert all((ROOT / name).exists() for name in copied)
    packages = project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
    assert {*packages, "pyproject.toml", project["project"]["readme"]} <= copied
    assert f"--tag coilcal:{project['project']['version']} " in dockerfile
    (base,), (user,) = ([line[1] for line in lines if line[:1] == [key]] for key in ("FROM", "USER"))
    assert base.removeprefix("python:").removesuffix("-slim") in project["project"]["requires-python"]
    assert "XDG_CACHE_HOME=/var/cache/coilcal" in next(line for line in lines if line[:1] == ["ENV"])
    context = pod()["securityContext"]
    assert user == f"{context['runAsUser']}:{context['runAsGroup']}"
    assert "--no-cache-dir --constraint constraints.txt" in dockerfile


def test_only_named_proxies_are_believed(tmp_path):
    app = create_app(
        Settings(
            data=tmp_path / "data",
            allowed_hosts=("coils.lab.example",),
            proxies=("10.0.0.0/8",),
            most_refused_per_minute=2,
        ),
        has_workers=False,
    )
    secret, _ = create_token(app.state.core.database, "anne", Scope.READ, 1.0)
    page = {
        "Authorization": f"Bearer {secret}",
        "Host": "coils.lab.example",
        "Origin": "https://coils.lab.example",
    }
    secure = {**page, "X-Forwarded-Proto": "https", "X-Forwarded-For": "192.0.2.7"}

    def client(address: str) -> TestClient:
        return TestClient(app, base_url="http://127.0.0.1:8765", client=(address, 5))

    with client("10.1.2.3") as proxy:
        assert proxy.get("/v1/state", headers=secure).status_code == 200
        assert refusal(proxy.get("/v1/state", headers=page), 403)["thing"] == "origin"
        other = client("127.0.0.1")
        assert refusal(other.get("/v1/state", headers=secure), 403)["thing"] == "origin"
        for _ in range(2):  # guesses count for the address behind the proxy
            refusal(proxy.get("/v1/state", headers={**secure, "Authorization": "Bearer x"}), 401)
        refusal(proxy.get("/v1/state", headers=secure), 429)
        elsewhere = {**secure, "X-Forwarded-For": "192.0.2.8"}
        assert proxy.get("/v1/state", headers=elsewhere).status_code == 200


def test_proxies_are_addresses_and_make_tokens_needed(idle):
    assert Settings(proxies=("127.0.0.1",)).needs_tokens
    refusal(idle(proxies=("127.0.0.1",)).get("/v1/state"), 401)
    for wrong in ("*", "proxy.lab.example", "10.0.0.1/8", ""):
        with pytest.raises(InvalidInput, match="proxies must be addresses or networks"):
            load_settings(None, {"COILCAL_SERVE_PROXIES": wrong or ",,x"})
