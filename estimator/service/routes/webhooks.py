"""Webhooks: addresses that get a message when a job has ended, and the log of these messages."""

from __future__ import annotations

import base64
import json
import secrets
from typing import Annotated, Literal

from fastapi import Query
from pydantic import BaseModel, Field
from sqlalchemy import delete, func, select

from estimator.service.answers import ListingOf, Page, row_of, shown_as
from estimator.service.database import new_id, now
from estimator.service.post import LONGEST_URL, SECRET_PREFIX, check_url
from estimator.service.problems import check_limits
from estimator.service.requests import ChangeOf, Id, router_of
from estimator.service.schema import Delivery, Webhook
from estimator.service.tokens import Scope
from estimator.service.webhooks import TEST, message

router = router_of("/v1/webhooks", "webhooks", scope=Scope.ADMIN)
MOST_WEBHOOKS = 20


class NewWebhook(BaseModel, extra="forbid"):
    """A webhook to make."""

    url: Annotated[str, Field(min_length=1, max_length=LONGEST_URL, description="Address that takes POST.")]


class WebhookInfo(BaseModel):
    """A webhook."""

    id: str
    url: str
    created: str
    user: str


class CreatedWebhook(WebhookInfo):
    """A webhook with its secret, which is shown once."""

    secret: Annotated[str, Field(description="Messages are signed with it, as Standard Webhooks describes.")]


class DeliveryInfo(BaseModel):
    """A message and what became of it; `fault` is of its last attempt."""

    id: str
    event: str
    state: Literal["waiting", "delivered", "failed"]
    created: str
    attempts: int
    next_attempt: str | None
    status: int | None
    fault: str | None
    ended: str | None


@router.post("", status_code=201)
def create_webhook(change: ChangeOf, body: NewWebhook) -> CreatedWebhook:
    """Send a message to an address whenever a job has ended."""
    check_url(body.url, change.core.settings.webhook_networks)
    secret = SECRET_PREFIX + base64.b64encode(secrets.token_bytes(32)).decode()
    with change.core.database.writing() as db:
        limits = {"webhooks": (db.scalar(select(func.count()).select_from(Webhook)), MOST_WEBHOOKS)}
        check_limits(limits, 409, "must be at most {}; delete one first")
        row = Webhook(id=new_id(), url=body.url, secret=secret, created=now(), user=change.caller.user)
        db.add(row)
        change.note(db, "webhook.create", row.id)
    return shown_as(CreatedWebhook, row)


@router.get("")
def list_webhooks(listing: ListingOf) -> Page[WebhookInfo]:
    """Webhooks, newest first."""
    return listing.page(Webhook, WebhookInfo)


@router.delete("/{webhook_id}", status_code=204)
def delete_webhook(change: ChangeOf, webhook_id: Id) -> None:
    """Delete a webhook with the messages that wait."""
    with change.core.database.writing() as db:
        row = row_of(db, Webhook, webhook_id, "webhook")
        db.execute(delete(Delivery).where(Delivery.webhook_id == webhook_id))
        db.delete(row)
        change.note(db, "webhook.delete", webhook_id)


@router.post("/{webhook_id}/test", status_code=202)
def send_test(change: ChangeOf, webhook_id: Id) -> DeliveryInfo:
    """Send a message without content, as a test."""
    with change.core.database.writing() as db:
        row_of(db, Webhook, webhook_id, "webhook")
        body = json.dumps({"type": TEST, "timestamp": now(), "data": {"user": change.caller.user}})
        row = message(webhook_id, TEST, body)
        db.add(row)
        change.note(db, "webhook.test", webhook_id)
    return shown_as(DeliveryInfo, row)


@router.get("/{webhook_id}/deliveries")
def list_deliveries(
    webhook_id: Id,
    listing: ListingOf,
    state: Annotated[Literal["waiting", "delivered", "failed"] | None, Query()] = None,
) -> Page[DeliveryInfo]:
    """Messages to a webhook, newest first."""
    with listing.core.database.reading() as db:
        row_of(db, Webhook, webhook_id, "webhook")
    return listing.page(Delivery, DeliveryInfo, webhook_id=webhook_id, state=state)
