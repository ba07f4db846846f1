"""Messages to webhooks: each is sent until it is accepted, or until it was tried long enough.

Messages are rows, written in the transaction of what they tell of. A kill between an answer and its row sends a message again, under the
same id.
"""

from __future__ import annotations

import asyncio
import json
import logging
import math
import threading
import time
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from typing import Any

from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session

from estimator.service.database import Database, new_id, now
from estimator.service.post import MOST_S, Undelivered, post
from estimator.service.schema import Delivery, Job, Webhook
from estimator.service.settings import Settings

WAITING, DELIVERED, FAILED = "waiting", "delivered", "failed"
JOB_ENDED, TEST = "job.ended", "test"
# Seconds before each further attempt; a weekend with the receiver off is survived by few more.
PAUSES_S = (5, 60, 600, 3600, 6 * 3600, 24 * 3600)
KEPT_DAYS = 90  # of what was delivered or has failed
LOOK_EVERY_S, REMOVE_EVERY_S = 1.0, 3600.0
MOST_LATE_S = 5.0  # between the end of a receiver's time and the row that tells of it
log = logging.getLogger("coilcal.service")


def announce(db: Session, event: str, data: Mapping[str, Any]) -> None:
    """Queue a message for every webhook, in the transaction of what it tells of."""
    body = json.dumps({"type": event, "timestamp": now(), "data": dict(data)})
    for webhook_id in db.scalars(select(Webhook.id)):
        db.add(message(webhook_id, event, body))


def announce_end(db: Session, job: Job, result: Mapping[str, Any] | None = None) -> None:
    """Tell of a job that has ended."""
    names = ("id", "kind", "state", "session_id", "user", "created", "started", "ended", "fault")
    announce(db, JOB_ENDED, {name: getattr(job, name) for name in names} | {"result": dict(result or {})})


def message(webhook_id: str, event: str, body: str) -> Delivery:
    """A message that waits for its first attempt."""
    row = Delivery(id=new_id(), webhook_id=webhook_id, event=event, body=body, created=now())
    row.state, row.attempts, row.next_attempt = WAITING, 0, row.created
    return row


class Deliveries:
    """Sends the messages that are due.

    Args:
        database: Where they are kept.
        settings: Networks that may be reached though they are not public.
    """

    def __init__(self, database: Database, settings: Settings) -> None:
        self._database, self._settings = database, settings
        self._removed_s = -math.inf
        self._at_work: dict[str, threading.Thread] = {}  # by webhook

    def tick(self) -> None:
        """Begin to send what is due, and delete old messages once an hour."""
        self.begin_due()
        if time.monotonic() - self._removed_s >= REMOVE_EVERY_S:
            self.remove_old()
            self._removed_s = time.monotonic()

    def begin_due(self) -> list[threading.Thread]:
        """Try the oldest message of each webhook that is due, in a thread for each; a receiver that is slow holds up its own messages only.

        Returns: The threads.
        """
        self._at_work = {each: thread for each, thread in self._at_work.items() if thread.is_alive()}
        with self._database.reading() as db:
            due = select(func.min(Delivery.number)).where(
                Delivery.state == WAITING,
                Delivery.next_attempt <= now(),
                Delivery.webhook_id.not_in(self._at_work),
            )
            numbers = list(db.scalars(due.group_by(Delivery.webhook_id)))
            query = select(Delivery, Webhook).join(Webhook, Webhook.id == Delivery.webhook_id)
            rows = [(row[0], row[1]) for row in db.execute(query.where(Delivery.number.in_(numbers)))]
        begun = {webhook.id: self._begun(delivery, webhook) for delivery, webhook in rows}
        self._at_work |= begun
        return list(begun.values())

    def stop(self) -> None:
        """Wait for what is being delivered; a receiver has its own time to answer."""
        end_s = time.monotonic() + MOST_S + MOST_LATE_S
        for thread in self._at_work.values():
            thread.join(max(0.0, end_s - time.monotonic()))

    def remove_old(self) -> None:
        """Delete messages that ended long ago."""
        before = (datetime.now(UTC) - timedelta(days=KEPT_DAYS)).isoformat(timespec="milliseconds")
        with self._database.writing() as db:
            db.execute(delete(Delivery).where(Delivery.state != WAITING, Delivery.created < before))

    def _begun(self, delivery: Delivery, webhook: Webhook) -> threading.Thread:
        thread = threading.Thread(
            target=lambda: asyncio.run(self._deliver(delivery, webhook)), name="coilcal delivery", daemon=True
        )
        thread.start()
        return thread

    async def _deliver(self, delivery: Delivery, webhook: Webhook) -> None:
        fault, status = None, None
        try:
            body, networks = delivery.body.encode(), self._settings.webhook_networks
            status = await post(webhook.url, webhook.secret, delivery.id, int(time.time()), body, networks)
        except Undelivered as undelivered:
            fault = str(undelivered)
        except Exception as error:
            log.exception("a webhook could not be told", extra={"webhook": webhook.id})
            fault = f"message must be sent; it was not: {type(error).__name__}"
        with self._database.writing() as db:
            row = db.get(Delivery, delivery.number)
            if row is None:  # its webhook was deleted
                return
            row.attempts, row.status, row.fault = row.attempts + 1, status, fault
            is_last = row.attempts > len(PAUSES_S)
            if fault is None or is_last:
                row.state, row.next_attempt = DELIVERED if fault is None else FAILED, None
                row.ended = now()
            else:
                later = datetime.now(UTC) + timedelta(seconds=PAUSES_S[row.attempts - 1])
                row.next_attempt = later.isoformat(timespec="milliseconds")
        log.info("webhook", extra={"webhook": webhook.id, "delivery": delivery.id, "fault": fault})
