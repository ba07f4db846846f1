"""One signed request to a webhook: to a public address that is looked up once, without redirects, with an end.

The address of a webhook must not lead to a network that only the service reaches. The name is resolved here, all its addresses are
checked, and the connection goes to the checked address, so that the name cannot mean another one a moment later.

References: the specification of Standard Webhooks, for which receivers have libraries.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import ipaddress
import re
import socket
import threading
from collections.abc import Sequence
from concurrent.futures import Future
from typing import Any
from urllib.parse import urlsplit

import httpx

from estimator.errors import CoilcalError, reason
from estimator.service.problems import Problem

SECRET_PREFIX = "whsec_"
LONGEST_URL = 500
HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]*[A-Za-z0-9])?")
MOST_S = 15.0  # from the question for the name's address to the head of the answer
PUBLIC_V6 = ipaddress.IPv6Network("2000::/3")  # so no mapped, translated (64:ff9b::/96) or local address
# Of IANA's registries of special-purpose addresses those that `is_global` of some Python calls public, at which the nearest router of the
# service's own network answers (anycast of NAT, 6to4, AMT, AS112), or nobody. No receiver of messages is there.
SPECIAL = tuple(
    ipaddress.ip_network(network)
    for network in (
        "192.0.0.0/24",
        "192.31.196.0/24",
        "192.52.193.0/24",
        "192.88.99.0/24",
        "192.175.48.0/24",
        "224.0.0.0/4",
        "2001::/23",
        "2620:4f:8000::/48",
        "3fff::/20",
        "2002::/16",  # leads to an IPv4 address inside
    )
)
Address = ipaddress.IPv4Address | ipaddress.IPv6Address


class Undelivered(CoilcalError):
    """The receiver did not take it; the message says why."""


def check_url(url: str, networks: Sequence[str]) -> None:
    """Refuse what is no address of a webhook.

    Args:
        url: The address.
        networks: Networks that are not public and may be reached all the same.
    Raises:
        Problem: Another scheme, no host, a user or a fragment, or an address that may not be reached.
    """
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
        has_more = bool(parts.username or parts.password or parts.fragment)
        httpx.URL(url)
    except (ValueError, httpx.InvalidURL):
        host, port, has_more = None, None, True
    is_named = host is not None and port != 0 and (":" in host or HOST.fullmatch(host))
    if not is_named or has_more or parts.scheme not in ("http", "https") or len(url) > LONGEST_URL:
        raise Problem(422, "url", "must be an http or https address without user and fragment", url, "body")
    literal = _literal(str(host))  # names are looked up when something is sent
    if literal is not None and not may_reach(literal, networks):
        raise Problem(
            422, "url", "must not be at a private address, unless webhook_networks names it", url, "body"
        )


def _literal(host: str) -> Address | None:
    """The address that a host spells, such as 127.1 or 0x7f000001 for 127.0.0.1; None for a name."""
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        pass
    try:
        return ipaddress.IPv4Address(socket.inet_aton(host))
    except OSError:
        return None


def may_reach(address: Address, networks: Sequence[str]) -> bool:
    """Whether an address is public, or in a network that is allowed.

    Examples:
        >>> [may_reach(ipaddress.ip_address(a), ()) for a in ("93.184.216.34", "192.0.0.192", "::ffff:127.0.0.1", "fe80::1")]
        [True, False, False, False]
        >>> may_reach(ipaddress.ip_address("10.0.0.1"), ["10.0.0.0/24"])
        True
    """
    if any(address in ipaddress.ip_network(network) for network in networks):
        return True
    is_plain = isinstance(address, ipaddress.IPv4Address) or address in PUBLIC_V6
    return is_plain and address.is_global and not any(address in network for network in SPECIAL)


def signature(secret: str, message_id: str, time_s: int, body: bytes) -> str:
    """The value of `webhook-signature`: HMAC-SHA256 over id, time and body."""
    key = base64.b64decode(secret.removeprefix(SECRET_PREFIX))
    signed = f"{message_id}.{time_s}.".encode() + body
    return "v1," + base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest()).decode()


async def post(
    url: str, secret: str, message_id: str, time_s: int, body: bytes, networks: Sequence[str]
) -> int:
    """Send a message to a webhook.

    Args:
        url: Its address.
        secret: Its secret, with which the message is signed.
        message_id: Id of the message, the same for every attempt.
        time_s: Present time, seconds since 1970.
        body: The message.
        networks: Networks that are not public and may be reached all the same.
    Returns: Status of the answer, which is 2xx.
    Raises:
        Undelivered: Another answer, none in time, or an address that may not be reached.
    """
    headers = {
        "content-type": "application/json",
        "user-agent": "coilcal",
        "webhook-id": message_id,
        "webhook-timestamp": str(time_s),
        "webhook-signature": signature(secret, message_id, time_s, body),
    }
    try:
        async with asyncio.timeout(MOST_S):
            status = await _status(url, headers, body, networks)
    except TimeoutError:
        raise Undelivered(f"receiver must answer within {MOST_S:g} s") from None
    except (httpx.HTTPError, httpx.InvalidURL, OSError) as error:
        why = reason(error) if isinstance(error, OSError) else str(error) or type(error).__name__
        raise Undelivered(f"receiver must be reached; it is not: {why}") from error
    if not 200 <= status < 300:
        raise Undelivered(f"receiver must answer with a status of 2xx; it answers {status}")
    return status


async def _status(url: str, headers: dict[str, str], body: bytes, networks: Sequence[str]) -> int:
    target = httpx.URL(url)
    address = await _address(target.host, target.port or (443 if target.scheme == "https" else 80), networks)
    pinned = target.copy_with(host=str(address))
    headers["host"] = target.netloc.decode("ascii")
    # The environment's proxies would look the name up again.
    async with httpx.AsyncClient(trust_env=False, follow_redirects=False, timeout=MOST_S) as client:
        request = client.build_request(
            "POST", pinned, headers=headers, content=body, extensions={"sni_hostname": target.host}
        )
        answer = await client.send(request, stream=True)  # its body is not read
        await answer.aclose()
        return answer.status_code


async def _address(host: str, port: int, networks: Sequence[str]) -> Address:
    """The address of a host, all of whose addresses may be reached."""
    looked_up = await asyncio.wrap_future(_looked_up(host, port))
    addresses = [ipaddress.ip_address(str(entry[4][0]).partition("%")[0]) for entry in looked_up]
    for address in addresses:
        if not may_reach(address, networks):
            raise Undelivered(
                f"receiver must not be at a private address, unless webhook_networks names it; {host} is at {address}"
            )
    return addresses[0]


def _looked_up(host: str, port: int) -> Future[list[Any]]:
    """The addresses of a name, from a thread of its own: the end of an event loop waits for its threads, and a name server may be slow."""
    answer: Future[list[Any]] = Future()

    def look_up() -> None:
        if not answer.set_running_or_notify_cancel():
            return
        try:
            answer.set_result(socket.getaddrinfo(host, port, type=socket.SOCK_STREAM))
        except Exception as error:
            answer.set_exception(error)

    threading.Thread(target=look_up, name="coilcal name", daemon=True).start()
    return answer
