"""Lists of the service, which come page by page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from estimator.client.connection import Http


async def page_after(
    connection: Http, path: str, params: Mapping[str, Any], cursor: str | None
) -> dict[str, Any]:
    """A page of a list, the first without a cursor: `items`, and in `next` the cursor of the page that follows, or None."""
    asked = dict(params) if cursor is None else {**params, "cursor": cursor}
    return await connection.json("GET", path, params=asked)


async def whole_list(connection: Http, path: str) -> list[dict[str, Any]]:
    """Every item of a list."""
    page = await page_after(connection, path, {}, None)
    items = list(page["items"])
    while page["next"] is not None:
        page = await page_after(connection, path, {}, page["next"])
        items += page["items"]
    return items
