"""Which site a request comes from, and where its head ends: what a page of another site or a proxy in front may get wrong is refused."""

from __future__ import annotations

import ipaddress
import re

from starlette.datastructures import Headers
from starlette.types import Scope

from estimator.service.page_files import PAGE
from estimator.service.problems import Problem
from estimator.service.settings import Settings

# A name or an address, and a port.
HOST = re.compile(r"([^\s\[\]:/?#@\\]+|\[[0-9A-Fa-f:.]+\])(?::[0-9]{0,5})?")
LOOPBACK_NAMES = ("localhost", "127.0.0.1", "[::1]")


class Site:
    """Names under which the service is reached.

    Args:
        settings: Its address, and further names.
    """

    def __init__(self, settings: Settings) -> None:
        self._is_everywhere = settings.host in ("0.0.0.0", "::")
        own = LOOPBACK_NAMES if settings.is_loopback else (_bracketed(settings.host),)
        self._hosts = {name.lower() for name in (*own, *settings.allowed_hosts)}

    def check(self, scope: Scope, headers: Headers) -> None:
        """Refuse what a page of another site makes a browser send: by its own name for this address, or across origins."""
        host = headers.get("host", "")
        written = HOST.fullmatch(host)
        name = host if written is None else written[1].lower()
        is_any = self._is_everywhere and _is_address(name)
        if written is None or (name not in self._hosts and not is_any):
            raise Problem(
                403, "host", "must be the service's address or one of allowed_hosts", name, "header Host"
            )
        origin = headers.get("origin")
        if origin is not None and origin != f"{scope['scheme']}://{host}":
            raise Problem(403, "origin", "must be the service itself", origin, "header Origin")
        # A link to the page, from a wiki.
        is_link = scope["path"] == PAGE and headers.get("sec-fetch-mode") == "navigate"
        if headers.get("sec-fetch-site", "none") not in ("none", "same-origin") and not is_link:
            raise Problem(
                403, "site", "must be the service itself", headers["sec-fetch-site"], "header Sec-Fetch-Site"
            )


def check_framing(scope: Scope, headers: Headers) -> None:
    """Refuse a body whose end a proxy in front may see elsewhere, and with it a second request inside (RFC 9112, section 6.1).

    h11 would go by Transfer-Encoding, which is allowed, and keep the connection open, which is not.
    """
    if "transfer-encoding" not in headers:
        return
    is_old = scope.get("http_version") == "1.0"
    if is_old or "content-length" in headers:
        rule = "must not be given in HTTP/1.0" if is_old else "must not stand beside Content-Length"
        raise Problem(
            400, "Transfer-Encoding", rule, place="header Transfer-Encoding", headers={"Connection": "close"}
        )


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _is_address(name: str) -> bool:
    """Whether a host is a plain address, which no page of another site can make its own name for."""
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True
