"""Conversations written down in tests: `conversation(("sent", "received"), ...)` is a port that plays the instrument."""

from __future__ import annotations

from drivers.transport.transcript import Chunk, ReplayedPort


def conversation(*exchanges):
    chunks = []
    for sent, received in exchanges:
        chunks.append(Chunk(0.0, ">", sent))
        if received:
            chunks.append(Chunk(0.0, "<", received))
    return ReplayedPort(chunks, "transcript")
