"""Calls of the service without a transport: generators that yield what is to be done and are sent the outcome.

Each call of the API is written once, as such a generator. `connection.py` carries it out, waiting for each step or awaiting it.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias, TypeVar

import httpx

from estimator.client.errors import ServiceFault
from estimator.errors import InvalidInput

T = TypeVar("T")
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 30.0
BUSY = (408, 429, 503)  # the same request may be accepted in a moment


@dataclass(frozen=True)
class Send:
    """A request. Its outcome is the `httpx.Response`, which is no refusal.

    Attributes:
        method, path: What is asked for.
        call: Further arguments of httpx.
    """

    method: str
    path: str
    call: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Listen:
    """A stream to be read. It is over when the service ends it or the connection breaks.

    Attributes:
        path: The stream.
        headers: Of the request.
        take: Called with each line.
    """

    path: str
    headers: Mapping[str, str]
    take: Callable[[str], None]


@dataclass(frozen=True)
class Wait:
    """A pause."""

    pause_s: float


@dataclass(frozen=True)
class Work:
    """Something that takes long in this process. Its outcome is what the function returns."""

    function: Callable[[], Any]


Step: TypeAlias = Send | Listen | Wait | Work
Steps: TypeAlias = Generator[Step, Any, T]


def send(method: str, path: str, **call: Any) -> Steps[httpx.Response]:
    """A request as a call of one step."""
    answer: httpx.Response = yield Send(method, path, call)
    return answer


def send_json(method: str, path: str, **call: Any) -> Steps[dict[str, Any]]:
    """The JSON object that answers a request."""
    answer: httpx.Response = yield Send(method, path, call)
    return dict(answer.json())


class Attempts:
    """Attempts of one request: whether and when it is made again.

    Args:
        url: Address of the service, for messages.
        most: How many there are at most.
    """

    def __init__(self, url: str, most: int) -> None:
        self._url, self._most, self._made = url, most, 0

    def pause_s(self, outcome: httpx.Response | httpx.TransportError) -> float | None:
        """Time until the next attempt; None if the service has answered.

        Raises:
            InvalidInput: The service refuses the request; the message is its sentence.
            ServiceFault: It cannot be reached, or fails, and this was the last attempt.
        """
        pause_s = min(FIRST_PAUSE_S * 2.0**self._made, LONGEST_PAUSE_S)
        self._made += 1
        if isinstance(outcome, httpx.TransportError):
            fault = f"service must answer; {self._url} does not: {outcome}"
        elif outcome.is_success:
            return None
        else:
            fault = sentence(outcome)
            if outcome.status_code not in BUSY:
                raise (ServiceFault if outcome.is_server_error else InvalidInput)(fault)
            after = outcome.headers.get("retry-after", "")
            if after.isdecimal():
                pause_s = min(float(after), LONGEST_PAUSE_S)  # the service knows better
        if self._made >= self._most:
            raise ServiceFault(fault)
        return pause_s


def sentence(answer: httpx.Response) -> str:
    """What a refusal says."""
    try:
        return str(answer.json()["detail"])
    except (ValueError, KeyError, TypeError):
        return f"service must answer as coilcal does; it says {answer.status_code} {answer.reason_phrase}"
