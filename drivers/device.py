"""Base of all devices: leaving the `with` block closes the device and does not hide the error that ended the block."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from types import TracebackType
from typing import Self

from drivers.errors import DriverError

_LOG = logging.getLogger(__name__)


class ClosesItself(ABC):
    """A device that is closed when its `with` block ends."""

    @abstractmethod
    def close(self) -> None:
        """See `drivers.protocols.Device.close`."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if exc is None:
            self.close()
            return
        try:
            self.close()
        except DriverError as error:
            _LOG.error("closing failed too, after %s: %s", exc, error)
