"""Ports that play an instrument: `conversation((b"sent", b"received"), ...)` answers at once, `ScriptedPort` with delays."""

from __future__ import annotations

import time

from drivers.transport.transcript import Chunk, ReplayedPort

played = []  # every conversation of the running test


def conversation(*exchanges):
    """A port for one conversation, which the test must play to its end (`conftest.whole_conversations`)."""
    chunks = []
    for sent, received in exchanges:
        chunks.append(Chunk(0.0, ">", sent))
        if received:
            chunks.append(Chunk(0.0, "<", received))
    played.append(ReplayedPort(chunks, "transcript"))
    return played[-1]


class ScriptedPort:
    """Answers each message with the next of `answers`: pairs of a delay in seconds and a piece."""

    name = "scripted"
    arrived_s = 0.0

    def __init__(self, *answers):
        self.answers = list(answers)
        self.due = []
        self.sent = b""
        self.is_closed = False

    def send(self, data, deadline):
        self.sent += data
        now_s = time.monotonic()
        self.due += [
            (now_s + delay_s, piece) for delay_s, piece in (self.answers.pop(0) if self.answers else [])
        ]

    def receive(self, deadline):
        while True:
            if self.due and time.monotonic() >= self.due[0][0]:
                return self.due.pop(0)[1]
            if deadline.is_over:
                raise deadline.exceeded("scripted must receive", "nothing came")
            time.sleep(0.001)

    def close(self):
        self.is_closed = True
