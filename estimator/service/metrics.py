"""What the service counts of itself, in the text format of Prometheus."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib.metadata import version

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from sqlalchemy import func, select

from estimator.service.database import Database
from estimator.service.job_queue import STATES
from estimator.service.schema import Delivery, Job, SessionRow
from estimator.service.settings import Settings

NO_ROUTE = "none"  # paths that are not there: as they were asked for, they would fill the memory
DURATIONS_S = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0)


class Metrics:
    """Counters of one application; everything that the database knows is asked for when they are read."""

    def __init__(self, database: Database, settings: Settings) -> None:
        self._registry = CollectorRegistry()
        ProcessCollector(registry=self._registry)
        self._requests = Counter(
            "coilcal_requests",
            "Requests that were answered.",
            ("method", "route", "status"),
            registry=self._registry,
        )
        self._durations_s = Histogram(
            "coilcal_request_duration_seconds",
            "Time from a request to the beginning of its answer.",
            ("method", "route"),
            buckets=DURATIONS_S,
            registry=self._registry,
        )
        self.readings = Counter(
            "coilcal_readings_acknowledged", "Readings that were put on disk.", registry=self._registry
        )
        build = Gauge("coilcal_build_info", "Version that runs.", ("version",), registry=self._registry)
        build.labels(version("coilcal")).set(1)
        self._registry.register(_Stored(database, settings))

    def answered(self, method: str, route: str, status: int, took_s: float) -> None:
        """Count a request whose answer begins."""
        self._requests.labels(method, route, str(status)).inc()
        self._durations_s.labels(method, route).observe(took_s)

    def watch(self, name: str, words: str, read: Callable[[], float]) -> None:
        """Ask for a number whenever the others are read."""
        Gauge(name, words, registry=self._registry).set_function(read)

    def text(self) -> bytes:
        """All metrics in the text format of Prometheus."""
        return generate_latest(self._registry)


class _Stored(Collector):
    """Numbers of jobs and sessions, from the database."""

    def __init__(self, database: Database, settings: Settings) -> None:
        self._database, self._settings = database, settings

    def describe(self) -> list[Metric]:
        """No metrics, so that the database is not asked before there is one."""
        return []

    def collect(self) -> Iterator[Metric]:
        """Metrics of what is in the database now."""
        with self._database.reading() as db:
            jobs, sessions, deliveries = (
                {row[0]: row[1] for row in db.execute(select(column, func.count()).group_by(column))}
                for column in (Job.state, SessionRow.state, Delivery.state)
            )
        yield _gauge("coilcal_jobs", "Jobs by state.", {state: jobs.get(state, 0) for state in STATES})
        yield _gauge(
            "coilcal_sessions", "Sessions by state.", {s: sessions.get(s, 0) for s in ("open", "closed")}
        )
        told = {state: deliveries.get(state, 0) for state in ("waiting", "delivered", "failed")}
        yield _gauge("coilcal_webhook_deliveries", "Messages to webhooks by state.", told)
        yield GaugeMetricFamily(
            "coilcal_jobs_at_once", "Jobs that can run at once.", self._settings.n_workers
        )
        yield GaugeMetricFamily("coilcal_most_queued", "Jobs that may wait.", self._settings.most_queued)


def _gauge(name: str, words: str, values: dict[str, int]) -> Metric:
    family = GaugeMetricFamily(name, words, labels=("state",))
    for state, n in values.items():
        family.add_metric((state,), n)
    return family
