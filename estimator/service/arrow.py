"""Predictions as an Apache Arrow stream: a record batch for each block of points, read by pandas, R, Julia and others without parsing."""

from __future__ import annotations

import io
from collections.abc import AsyncIterator, Mapping

import pyarrow as pa
from torch import Tensor

from estimator.calibration.predictions import FIELD, GRADIENT

ARROW = "application/vnd.apache.arrow.stream"
AXES = "xyz"


async def arrow_stream(
    blocks: AsyncIterator[tuple[Tensor, Mapping[str, Tensor]]], about: Mapping[str, str]
) -> AsyncIterator[bytes]:
    """The bytes of a stream.

    Args:
        blocks: Points in the world frame with what was predicted there; at least one.
        about: Metadata of its schema.
    """
    sink = io.BytesIO()
    writer: pa.RecordBatchStreamWriter | None = None
    async for points_m, answer in blocks:
        batch = pa.RecordBatch.from_pydict(columns_of(points_m, answer), metadata=dict(about))
        if writer is None:
            writer = pa.ipc.new_stream(sink, batch.schema)
        writer.write_batch(batch)
        yield _taken(sink)
    assert writer is not None  # there is no prediction without points
    writer.close()
    yield _taken(sink)


def columns_of(points_m: Tensor, answer: Mapping[str, Tensor]) -> dict[str, pa.Array]:
    """Points and components by name, such as `x_m`, `Bx_lower_T` and `dBx_dy_T_per_m`; null inside a winding."""
    columns = {f"{axis}_m": points_m[:, i] for i, axis in enumerate(AXES)}
    for name, end in zip(FIELD, ("", "_lower", "_upper"), strict=True):
        if name in answer:
            columns |= {f"B{axis}{end}_T": answer[name][:, i] for i, axis in enumerate(AXES)}
    for name, end in zip(GRADIENT, ("", "_lower", "_upper"), strict=True):
        if name in answer:
            columns |= {
                f"dB{of}_d{along}{end}_T_per_m": answer[name][:, i, j]
                for i, of in enumerate(AXES)
                for j, along in enumerate(AXES)
            }
    return {name: pa.array(values.numpy(), from_pandas=True) for name, values in columns.items()}


def _taken(sink: io.BytesIO) -> bytes:
    piece = sink.getvalue()
    sink.seek(0)
    sink.truncate()
    return piece
