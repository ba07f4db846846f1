"""Predictions: one after another, on a thread of their own, so that they hold up no other request and share the memory of one."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from estimator.calibration.result import Calibration
from estimator.service.concurrency import RefusingLimit

BLOCK = 2_000  # points of a question; with 400 draws they take 20 MB, and small questions pass between the blocks of a large one
RETRY_AFTER_S = 1
FIELD = ("field_T", "field_lower_T", "field_upper_T")
GRADIENT = ("gradient_T_per_m", "gradient_lower_T_per_m", "gradient_upper_T_per_m")


@dataclass(frozen=True)
class Wanted:
    """What is asked of a calibration wherever the points lie; arguments as of `Calibration.field_interval`."""

    currents_A: Mapping[str, float]
    motion: Mapping[str, Tensor]
    level: float = 0.9
    has_field: bool = True
    has_gradient: bool = False
    has_intervals: bool = True
    is_of_coils_alone: bool = False


def answer(calibration: Calibration, points_m: Tensor, wanted: Wanted) -> dict[str, Tensor]:
    """What `field`, `gradient` and their intervals say, by the names in `FIELD` and `GRADIENT`, in SI; NaN inside a winding.

    Raises:
        InvalidInput: As by these methods.
    """
    if wanted.is_of_coils_alone:
        calibration = calibration.coils_alone()
    told: dict[str, Tensor] = {}
    for is_wanted, (name, lower, upper), predict, interval in (
        (wanted.has_field, FIELD, calibration.field, calibration.field_interval),
        (wanted.has_gradient, GRADIENT, calibration.gradient, calibration.gradient_interval),
    ):
        if is_wanted:
            told[name] = predict(points_m, wanted.currents_A, wanted.motion)
        if is_wanted and wanted.has_intervals:
            told[lower], told[upper] = interval(points_m, wanted.currents_A, wanted.level, wanted.motion)
    return told


class Predictor:
    """Asks calibrations.

    Args:
        load: Reads a calibration of a folder, from memory if it is there.
        most_waiting: Requests that may be at work or wait: each counts once for `limit`, however many blocks it asks for.
    """

    def __init__(self, load: Callable[[Path], Calibration], most_waiting: int) -> None:
        self._load = load
        self.limit = RefusingLimit("predictions", most_waiting, retry_after_s=RETRY_AFTER_S)
        self._thread = ThreadPoolExecutor(1, "coilcal predictions")

    async def ask(self, folder: Path, points_m: Tensor, wanted: Wanted) -> dict[str, Tensor]:
        """The answer at `BLOCK` points at most.

        Raises:
            InvalidInput: As by `answer`.
            CorruptStore: The calibration is damaged.
        """
        asked = asyncio.get_running_loop().run_in_executor
        return await asked(self._thread, lambda: answer(self._load(folder), points_m, wanted))

    def close(self) -> None:
        """Answer what waits, and end."""
        self._thread.shutdown()
