"""Lists of the service, which come page by page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from estimator.client.steps import Steps, send_json


def page_after(path: str, params: Mapping[str, Any], cursor: str | None) -> Steps[dict[str, Any]]:
    """A page of a list, the first without a cursor: `items`, and in `next` the cursor of the page that follows, or None."""
    asked = dict(params) if cursor is None else {**params, "cursor": cursor}
    return (yield from send_json("GET", path, params=asked))


def whole_list(path: str) -> Steps[list[dict[str, Any]]]:
    """Every item of a list."""
    page = yield from page_after(path, {}, None)
    items = list(page["items"])
    while page["next"] is not None:
        page = yield from page_after(path, {}, page["next"])
        items += page["items"]
    return items
