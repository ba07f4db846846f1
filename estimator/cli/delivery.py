"""Delivers the readings of a session to a service while they are measured, for `coilcal acquire --to`.

The journal on disk is the buffer. The service says how many readings it holds, and the journal is read from there on, so that each
arrives once whatever is killed or cut off in between.
"""

from __future__ import annotations

import threading
import uuid
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from estimator.client import Client, RemoteSession, ServiceFault
from estimator.errors import CoilcalError, CorruptStore, InvalidInput, quoted, reason
from estimator.given_files import MOST_SETTINGS_BYTES
from estimator.json_files import read_json, sealed
from estimator.rig.rig import Rig
from estimator.store.files import write_text
from estimator.store.follow import Follower
from estimator.store.made import JOURNAL

RECEIPT = "delivery.json"
MOST_AT_ONCE = 200  # readings of one request
LONGEST_SOURCE = 500  # characters that the service takes
LOOK_EVERY_S = 0.2
FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 30.0


@dataclass(frozen=True)
class Receipt:
    """What a service has of a session; `delivery.json` in the session's folder.

    Attributes:
        url: Address of the service.
        key: Key under which the session is begun there, once however often that is asked for.
        session_id: Its id there; None before the first answer.
        n_acknowledged: Readings that are on disk there.
        hash: Hash of the closed session there; None before that.
    """

    url: str
    key: str
    session_id: str | None = None
    n_acknowledged: int = 0
    hash: str | None = None

    @classmethod
    def load(cls, session: Path) -> Receipt | None:
        """The receipt of a session; None if nothing was delivered yet.

        Raises:
            CorruptStore: The file holds something else.
        """
        if not (session / RECEIPT).exists():
            return None
        try:
            return cls(**read_json(session / RECEIPT, MOST_SETTINGS_BYTES, CorruptStore))
        except TypeError as error:
            raise CorruptStore(f"receipt must be as coilcal writes it; {session / RECEIPT} is not") from error

    def save(self, session: Path) -> None:
        """Write it; whole, or as it was."""
        write_text(session / RECEIPT, sealed(asdict(self), indent=2))


@dataclass(frozen=True)
class _Connection:
    """A session at the service, and the journal from which it is filled."""

    remote: RemoteSession
    follower: Follower
    rig: Rig

    def new_readings(self, first: int) -> list[dict[str, Any]]:
        """What the journal has got since the last call, numbered from `first`."""
        return [reading_of(entry, self.rig, first + i) for i, entry in enumerate(self.follower.entries())]


class Delivery:
    """Sends readings in a thread of its own, and goes on after any outage; a fault of the service never holds up a measurement.

    Args:
        session: Folder of the session, which need not exist yet.
        client: Connection to the service, which makes each request once; it is closed at the end.
        url: Its address.
        tell: Called with a sentence when an outage begins or ends.
        is_new: The session is begun anew, whatever lies in its folder now.
    Raises:
        InvalidInput: The session goes to another service.
    """

    def __init__(
        self, session: Path, client: Client, url: str, tell: Callable[[str], None], is_new: bool = False
    ) -> None:
        self._session, self._client, self._url, self._tell = session, client, url.rstrip("/"), tell
        known = None if is_new else Receipt.load(session)
        self._receipt = known or Receipt(self._url, uuid.uuid4().hex)
        if self._receipt.url != self._url:
            raise InvalidInput(
                f"session must be delivered to one service, {self._receipt.url}; received {self._url} ({session})"
            )
        self._connection: _Connection | None = None
        self._unsent: list[dict[str, Any]] = []
        self._is_complete, self._is_stopped = threading.Event(), threading.Event()
        self._is_out = False
        self.fault: str | None = None
        self._thread = threading.Thread(target=self._run, name="coilcal delivery", daemon=True)

    @property
    def receipt(self) -> Receipt:
        """What the service has."""
        return self._receipt

    def start(self) -> None:
        """Begin; the journal of the session must be there."""
        self._thread.start()

    def finish(self, patience_s: float) -> Receipt:
        """Wait until a session that is complete is delivered and closed at the service, for some time at most."""
        self._is_complete.set()
        self._thread.join(patience_s)
        self.stop()
        return self._receipt

    def stop(self) -> None:
        """Send nothing more; what is not sent waits in the journal."""
        self._is_stopped.set()

    def _run(self) -> None:
        with self._client:
            self._send_all()

    def _send_all(self) -> None:
        pause_s = FIRST_PAUSE_S
        while not self._is_stopped.is_set() and self._receipt.hash is None:
            try:
                has_sent = self._step()
            except (ServiceFault, OSError) as fault:  # of this computer's disk, on which the receipt stands
                self._connection = None
                if not self._is_out:
                    why = (
                        f"receipt must be writable: {reason(fault)}" if isinstance(fault, OSError) else fault
                    )
                    self._tell(f"{why}; readings wait in {self._session} until it is mended")
                self._is_out = True
                self._is_stopped.wait(pause_s)
                pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
                continue
            except CoilcalError as refusal:
                self.fault = str(refusal)
                self._tell(f"nothing more is sent to {self._url}: {refusal}")
                return
            if self._is_out:
                self._tell(f"{self._url} answers again and has {self._receipt.n_acknowledged} readings")
            self._is_out, pause_s = False, FIRST_PAUSE_S
            if not has_sent:
                self._is_stopped.wait(LOOK_EVERY_S)

    def _step(self) -> bool:
        """Send what has been measured since, or close a session that is complete; whether readings were sent."""
        is_complete = (
            self._is_complete.is_set()
        )  # asked before the journal is read, so that no reading is missed
        connection = self._connection or self._connected()
        if self._receipt.hash is not None:
            return False
        first = self._receipt.n_acknowledged + len(self._unsent)
        self._unsent += connection.new_readings(first)
        if self._unsent:
            n_readings = connection.remote.append(self._unsent[:MOST_AT_ONCE])
            del self._unsent[:MOST_AT_ONCE]
            self._note(n_acknowledged=n_readings)
            return True
        if is_complete:
            self._note(hash=connection.remote.close()["hash"])
        return False

    def _connected(self) -> _Connection:
        """The session at the service, begun where it is not, and the journal from where the service has it."""
        follower = Follower(self._session)
        rig = follower.rig
        self._receipt.save(self._session)  # its key is on disk before it is used
        if self._receipt.session_id is None:
            source = str(follower.header["source"])[:LONGEST_SOURCE]
            self._note(session_id=self._client.begin(rig, source, key=self._receipt.key).id)
        connection = _Connection(self._client.session(str(self._receipt.session_id)), follower, rig)
        known = connection.remote.info()
        readings = connection.new_readings(0)
        if known["n_readings"] > len(readings):
            raise InvalidInput(
                f"session {connection.remote.id} must hold no other readings than {self._session / JOURNAL}; "
                f"it holds {known['n_readings']} ({self._url})"
            )
        self._note(n_acknowledged=known["n_readings"], hash=known["hash"])
        self._unsent = readings[known["n_readings"] :]
        self._connection = connection
        return connection

    def _note(self, **changes: Any) -> None:
        self._receipt = replace(self._receipt, **changes)
        self._receipt.save(self._session)


def reading_of(entry: Mapping[str, Any], rig: Rig, sequence: int) -> dict[str, Any]:
    """An entry of a journal as the service takes it: all that becomes arrays of a session."""
    return {
        "sequence": sequence,
        "time_s": entry["time_s"],
        "current_A": {
            coil.name: current_A for coil, current_A in zip(rig.coils, entry["current_A"], strict=True)
        },
        "motion": entry["motion"],
        "field_T": entry["field_T"],
        "measured_A": entry.get("measured_A", {}),
        "temperature_C": entry.get("temperature_C", {}),
        "is_validation": entry["is_validation"],
        "repeat": entry["repeat"],
    }


def connected(url: str, token: str | None, tell: Callable[[str], None]) -> Client:
    """A connection to a service that takes readings; one that does not answer now may do so later.

    Raises:
        InvalidInput: The address is none, or the service refuses the token.
    """
    if not url.startswith(("http://", "https://")):
        raise InvalidInput(f"--to must be an http or https address; received {quoted(url)}")
    client = Client(url, token, attempts=1)
    try:
        scope = client.request("GET", "/v1/state").json()["scope"]
    except ServiceFault as fault:
        tell(f"{fault}; readings wait until it does")
    else:
        if scope == "read":
            raise InvalidInput("token must have the scope write; it has the scope read (COILCAL_TOKEN)")
    return client
