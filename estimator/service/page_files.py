"""The page: static files of this package, read once at start and served under paths that are fixed then.

No word of a request becomes part of a path. The files hold no data, so they need no token.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from importlib.resources import files

from fastapi import APIRouter, Request
from starlette.responses import Response

from estimator.service.answers import with_etag
from estimator.service.requests import JsonRoute

PAGE = "/"
MEDIA_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


@cache
def page_files() -> dict[str, tuple[bytes, str]]:
    """Content and media type of every file of the page, by the path that it is served under."""
    root = files("estimator.service") / "page"
    served: dict[str, tuple[bytes, str]] = {}
    for folder in ("", "vendor"):
        for file in sorted((root / folder).iterdir(), key=lambda item: item.name):
            media_type = MEDIA_TYPES.get(f".{file.name.rpartition('.')[2]}")
            if media_type is not None:
                path = "/".join(filter(None, ("/page", folder, file.name)))
                path = PAGE if file.name == "index.html" else path
                served[path] = file.read_bytes(), media_type
    return served


def page_router() -> APIRouter:
    """A route for each file."""
    router = APIRouter(route_class=JsonRoute, include_in_schema=False)
    for path, (content, media_type) in page_files().items():
        router.add_api_route(path, _answering(content, media_type), response_class=Response)
    return router


def _answering(content: bytes, media_type: str) -> Callable[[Request], Response]:
    tag = hashlib.sha256(content).hexdigest()[:32]

    def page_file(request: Request) -> Response:
        response = with_etag(request, tag, lambda: Response(content, media_type=media_type))
        # On 304 too, whose headers replace those of the copy.
        response.headers["Content-Security-Policy"] = POLICY
        return response

    return page_file
