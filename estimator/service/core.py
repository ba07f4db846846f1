"""Everything that routes work with, made once for an application."""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
from pathlib import Path

from sqlalchemy import select

from estimator.calibration.result import Calibration
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.what_if import fit_for_what_if
from estimator.errors import InvalidInput, reason
from estimator.service import alerts, removal, running_diagnosis, schedules, webhooks
from estimator.service.alerts import ALERTS
from estimator.service.cache import Cache
from estimator.service.concurrency import RefusingLimit, WaitingLimit
from estimator.service.database import Database, check_database
from estimator.service.dispatcher import Dispatcher
from estimator.service.job_queue import JobQueue
from estimator.service.logins import Cookies
from estimator.service.metrics import Metrics
from estimator.service.next_stops import NextStops
from estimator.service.open_sessions import OpenSessions
from estimator.service.periodic import scheduler_of
from estimator.service.predictions import Predictor
from estimator.service.schedules import Schedules
from estimator.service.schema import RigVersion
from estimator.service.settings import Settings
from estimator.service.storage import Storage
from estimator.service.watching import Watching
from estimator.service.webhooks import Deliveries
from estimator.store.session import load_session

DATABASE, LOCK = "coilcal.sqlite", "lock"
SESSIONS, JOBS, UPLOADS, REGISTRIES = "sessions", "jobs", "uploads", "registries"
MOST_CALIBRATION_BYTES = 512_000_000  # of draws in memory
MOST_FITS = 4
MOST_IMPORTS = 2  # sessions of `most_unpacked_MB` in memory
MOST_IMPORTS_WAITING = 20  # bodies of `most_body_MB` in memory
MOST_EXPORTS_WAITING = 20
MOST_QUESTIONS_WAITING = 20


class Core:
    """The data folder with its database, sessions, jobs and calibrations; one process has it at a time.

    Raises:
        InvalidInput: Another process has the folder, or it cannot be written.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings, self.data = settings, settings.data.absolute()
        check_database(self.data / DATABASE)  # before anything is put beside that of another program
        self._lock = _locked(self.data)
        self.database = Database(self.data / DATABASE)
        try:
            self.database.migrate()
        except BaseException:
            os.close(self._lock)
            raise
        self.storage = Storage(self.data)
        self.cookies = Cookies(self.data)
        self.sessions = OpenSessions(self.data / SESSIONS, settings.most_readings)
        self.queue = JobQueue(self.database, settings)
        self.metrics = Metrics(self.database, settings)
        self.jobs = Dispatcher(
            self.queue,
            settings,
            self.data / JOBS,
            self.sessions.path,
            lambda rig_id: self.rig_version(rig_id).text,
            self.registry_path,
        )
        self.deliveries = Deliveries(self.database, settings)
        self.watching = Watching(self.sessions.path, settings.most_watched, settings.running_diagnosis)
        self.schedules = Schedules(self.database, self.queue, self.jobs.wake)
        self.periodic = scheduler_of(
            {
                "webhooks": (webhooks.LOOK_EVERY_S, self.deliveries.tick),
                "alerts": (alerts.LOOK_EVERY_S, self.run_alerts),
                "removal": (removal.LOOK_EVERY_S, self.remove_old_jobs),
                "schedules": (schedules.LOOK_EVERY_S, self.schedules.tick),
                "running diagnosis": (running_diagnosis.LOOK_EVERY_S, self.watching.diagnose),
            }
        )
        self.streams = RefusingLimit("event streams", settings.most_streams, settings.most_streams_per_user)
        self.appenders: set[tuple[str, str | None]] = set()  # sessions and tokens whose first append is noted
        self.is_ending = False
        self._calibrations = Cache(Calibration.load, MOST_CALIBRATION_BYTES, _n_bytes)
        self.fits = Cache(self._fitted, MOST_FITS)
        self.importing = WaitingLimit("sessions to import", MOST_IMPORTS, MOST_IMPORTS_WAITING)
        self.next_stops = NextStops(self.sessions.rig, self.sessions.path)
        self.planning = WaitingLimit("next stops", 1, MOST_QUESTIONS_WAITING)
        self.exporting = WaitingLimit("exports", 1, MOST_EXPORTS_WAITING)
        self.predictor = Predictor(self.calibration, settings.most_predictions)
        self.metrics.watch("coilcal_event_streams", "Event streams that are followed.", self.streams.n_taken)
        words = "Predictions that are at work or wait."
        self.metrics.watch("coilcal_predictions_waiting", words, self.predictor.limit.n_taken)
        shutil.rmtree(self.uploads, ignore_errors=True)

    @property
    def uploads(self) -> Path:
        """Folder of what is being unpacked; it does not survive."""
        return self.data / UPLOADS

    def scratch(self) -> Path:
        """Folder of what is being unpacked, made where it is not there."""
        self.uploads.mkdir(parents=True, exist_ok=True)
        return self.uploads

    def registry_path(self, rig_name: str) -> Path:
        """Folder of the registry of a rig; no word of a request becomes part of it."""
        return self.data / REGISTRIES / hashlib.sha256(rig_name.encode()).hexdigest()[:32]

    def rig_version(self, rig_id: str) -> RigVersion:
        """A rig version that is known to be there."""
        with self.database.reading() as db:
            return db.scalars(select(RigVersion).where(RigVersion.id == rig_id)).one()

    def calibration(self, folder: Path) -> Calibration:
        """A calibration, checked when it is read; those used last stay in memory."""
        return self._calibrations[folder]

    def remove_folder(self, job_id: str) -> None:
        """Remove the folder of a job that is gone, and its calibration from memory."""
        folder = self.jobs.folder(job_id)
        shutil.rmtree(folder, ignore_errors=True)
        self._calibrations.forget(lambda path: Path(path).is_relative_to(folder))

    def run_alerts(self) -> None:
        """Run the command of the settings for conclusions that need action."""
        alerts.run_alerts(self.settings.alert_command, self.data / ALERTS, lambda: self.is_ending)

    def remove_old_jobs(self) -> int:
        """Remove jobs that ended longer ago than the settings keep them; their number."""
        return removal.remove_old_jobs(self.database, self.settings.keep_jobs_days, self.remove_folder)

    def _fitted(self, session_id: str) -> Fit:
        return fit_for_what_if(load_session(self.sessions.path(session_id)))

    def end_streams(self) -> None:
        """Let event streams end at their next look, for the service is about to; a client asks again when it is back."""
        self.is_ending = True

    def start(self) -> None:
        """Begin to work on jobs, to tell webhooks and to follow schedules."""
        removal.remove_folders_without_row(self.database, self.data / JOBS)
        self.jobs.start()
        self.periodic.start()

    def close(self) -> None:
        """Hand everything back for the next process."""
        self.end_streams()
        if self.periodic.running:
            self.periodic.shutdown()
        self.watching.stop()
        self.deliveries.stop()
        self.predictor.close()
        self.jobs.stop()
        self.sessions.close()
        self.database.close()
        os.close(self._lock)


def _n_bytes(calibration: Calibration) -> int:
    return sum(part.nbytes for part in calibration.draws.values())


def _locked(data: Path) -> int:
    try:
        data.mkdir(parents=True, exist_ok=True, mode=0o700)
        descriptor = os.open(data / LOCK, os.O_RDWR | os.O_CREAT, 0o600)
    except OSError as error:
        raise InvalidInput(
            f"data must be a folder that can be written; {data} is not: {reason(error)}"
        ) from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        raise InvalidInput(f"data must be used by one service at a time; another uses {data}") from error
    return descriptor
