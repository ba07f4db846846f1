"""Settings of the service: one YAML file, then variables of the environment, then options of the command line."""

from __future__ import annotations

import ipaddress
import math
import os
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from estimator.errors import InvalidInput
from estimator.yaml_section import Section

ENVIRONMENT = "COILCAL_SERVE_"  # COILCAL_DATA names the measured maps of studies
LARGEST_PORT = 65_535


@dataclass(frozen=True)
class Settings:
    """How the service runs. Each key stands in the YAML file by its name, and in the environment as `COILCAL_SERVE_<KEY>`.

    Attributes:
        data: Folder of everything that the service keeps.
        host: Address to listen at. Any other than loopback needs tokens.
        port: Port to listen at; 0 takes a free one.
        workers: Processes that run jobs; 0 means one per processor, less one for the service.
        scheduler: Address of a Dask scheduler whose workers run the jobs instead; they see `data` under the same path.
        require_tokens: Ask for tokens at loopback too.
        allowed_hosts: Names under which the service is reached, beside its address; a request for another one is refused.
        proxies: Addresses or networks of proxies whose X-Forwarded-For and X-Forwarded-Proto are believed; with one, tokens are needed.
        webhook_networks: Networks that are not public and that webhooks may reach all the same.
        alert_command: Command that runs for each drift, rejection or calibration that did not converge; JSON on its standard input.
        tls_certificate: PEM file of a certificate; with `tls_key` the service speaks HTTPS.
        tls_key: PEM file of its key.
        most_queued: Jobs that may wait, of all users together.
        most_queued_per_user: Jobs of one user that may wait.
        most_running_per_user: Jobs of one user that run at once.
        most_job_hours: Time after which a job is ended.
        most_body_MB: Size of a request's body.
        most_unpacked_MB: Size of an uploaded archive when it is unpacked.
        most_readings: Readings of one session, appended or imported.
        most_open_sessions: Sessions that may be open at once.
        most_open_sessions_per_user: Open sessions of one user.
        most_points: Points of one prediction.
        most_grid_points: Points of one prediction on a grid.
        most_predictions: Predictions that may be at work or wait at once.
        most_watched: Open sessions whose estimate is followed at once.
        running_diagnosis: Diagnose watched sessions as they grow, in one process of low priority.
        most_streams: Event streams that may be followed at once.
        most_streams_per_user: Event streams of one user.
        keep_jobs_days: Days after which jobs that have ended are removed, judgements of sessions excepted; 0 keeps them for ever.
        most_body_s: Time in which the body of a request must arrive.
        most_requests_per_minute: Requests of one token, and of one address without one, where tokens are needed.
        most_refused_per_minute: Requests of one address without a valid token, after which all others from there are refused too.
        places: Where each key was given, for messages; one that is missing has its default.
    """

    data: Path = Path("coilcal-data")
    host: str = "127.0.0.1"
    port: int = 8765
    workers: int = 0
    scheduler: str = ""
    require_tokens: bool = False
    allowed_hosts: tuple[str, ...] = ()
    proxies: tuple[str, ...] = ()
    webhook_networks: tuple[str, ...] = ()
    alert_command: str = ""
    tls_certificate: str = ""
    tls_key: str = ""
    most_queued: int = 200
    most_queued_per_user: int = 50
    most_running_per_user: int = 8
    most_job_hours: float = 24.0
    most_body_MB: float = 32.0
    most_unpacked_MB: float = 512.0
    most_readings: int = 200_000
    most_open_sessions: int = 500
    most_open_sessions_per_user: int = 250
    most_points: int = 20_000
    most_grid_points: int = 100_000
    most_predictions: int = 200
    most_watched: int = 8
    running_diagnosis: bool = True
    most_streams: int = 100
    most_streams_per_user: int = 60
    keep_jobs_days: float = 0.0
    most_body_s: float = 60.0
    most_requests_per_minute: int = 20_000
    most_refused_per_minute: int = 60
    places: Mapping[str, str] = field(default_factory=dict, compare=False, repr=False)

    @property
    def is_loopback(self) -> bool:
        """Whether only this computer reaches the service."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False

    @property
    def needs_tokens(self) -> bool:
        """Whether a request must carry a token; a proxy lets others reach a service at loopback."""
        return self.require_tokens or not self.is_loopback or bool(self.proxies)

    @property
    def n_workers(self) -> int:
        """Processes that run jobs, and so jobs that run at once."""
        return self.workers or max(1, len(os.sched_getaffinity(0)) - 1)

    @property
    def most_body_bytes(self) -> int:
        """Size of a request's body in bytes."""
        return int(self.most_body_MB * 1e6)

    def with_options(self, **options: Any) -> Settings:
        """These settings with those that were given on the command line; None leaves one as it is."""
        given = {name: value for name, value in options.items() if value is not None}
        places = {name: f"option --{name.replace('_', '-')}" for name in given}
        return checked(replace(self, **given, places={**self.places, **places}))

    def refused(self, key: str, rule: str, received: object) -> InvalidInput:
        """Why a value cannot be used, and where it was given."""
        place = f" ({self.places[key]})" if key in self.places else ""
        return InvalidInput(f"{key} {rule}; received {received}{place}")


KEYS = {item.name: item for item in fields(Settings) if item.name != "places"}


def load_settings(path: Path | None = None, environment: Mapping[str, str] | None = None) -> Settings:
    """Settings from a file and the environment, which wins.

    Raises:
        InvalidInput: An unknown key, or a value that breaks its rule.
    """
    environment = os.environ if environment is None else environment
    values, places = dict[str, Any](), dict[str, str]()
    if path is not None:
        section = Section.from_file(path)
        for key in KEYS:
            if key in section:
                places[key] = str(section.place(key))
                values[key] = _typed(key, section.value(key), places[key])
        section.finish()
    for key in KEYS:
        variable = f"{ENVIRONMENT}{key.upper()}"
        if variable in environment:
            places[key] = f"environment, {variable}"
            values[key] = _typed(key, _from_text(key, environment[variable]), places[key])
    return checked(Settings(**values, places=places))


def checked(settings: Settings) -> Settings:
    """The settings, if they can be used together.

    Raises:
        InvalidInput: A value is out of range, or one is given without the other that it needs.
    """
    for key in KEYS:
        value = getattr(settings, key)
        if key.startswith("most_") and not (math.isfinite(value) and value > 0):
            raise settings.refused(key, "must be > 0", value)
    if not 0 <= settings.port <= LARGEST_PORT:
        raise settings.refused("port", f"must be from 0 to {LARGEST_PORT}", settings.port)
    if not (math.isfinite(settings.keep_jobs_days) and settings.keep_jobs_days >= 0):
        raise settings.refused("keep_jobs_days", "must be >= 0", settings.keep_jobs_days)
    if settings.workers < 0:
        raise settings.refused("workers", "must be >= 0", settings.workers)
    if not settings.host:
        raise settings.refused("host", "must be an address or a name", "nothing")
    for key in ("proxies", "webhook_networks"):
        for network in getattr(settings, key):
            try:
                ipaddress.ip_network(network)
            except ValueError:
                raise settings.refused(key, "must be addresses or networks", repr(network[:80])) from None
    try:
        words = shlex.split(settings.alert_command)
    except ValueError as error:
        raise settings.refused(
            "alert_command", f"must be a command: {error}", repr(settings.alert_command)
        ) from None
    if settings.alert_command and not words:
        raise settings.refused("alert_command", "must be a command", repr(settings.alert_command))
    given = [key for key in ("tls_certificate", "tls_key") if getattr(settings, key)]
    if len(given) == 1:
        raise settings.refused(
            given[0], "must be given together with the other of tls_certificate and tls_key", "it alone"
        )
    return settings


WORDS: Mapping[type, str] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "text",
    tuple: "a list of words",
}


def _typed(key: str, value: Any, place: str) -> Any:
    """A value of the file as the settings take it, or a refusal."""
    kind: Any = str if key == "data" else type(KEYS[key].default)
    if kind is tuple:
        is_right = isinstance(value, list) and all(isinstance(word, str) for word in value)
    elif kind is float:
        is_right = isinstance(value, int | float) and not isinstance(value, bool)
    else:
        is_right = type(value) is kind
    if not is_right:
        raise InvalidInput(f"{key} must be {WORDS[kind]}; received {str(value)[:80]!r} ({place})")
    return Path(value) if key == "data" else kind(value)


def _from_text(key: str, text: str) -> Any:
    """The value that the text of a variable stands for, as YAML would give it."""
    default = KEYS[key].default
    try:
        if isinstance(default, bool):
            return {"true": True, "false": False}.get(text.lower(), text)
        if isinstance(default, tuple):
            return [word for word in text.split(",") if word]
        if isinstance(default, float):
            return float(text)
        return int(text) if isinstance(default, int) else text
    except ValueError:
        return text
