"""The log of the service: one JSON object a line on standard error, with the request that it belongs to."""

from __future__ import annotations

import json
import logging
import sys
from datetime import UTC, datetime

STANDARD = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName", "color_message"}


class JsonLines(logging.Formatter):
    """Formats a record as JSON; what was given as `extra` becomes keys.

    Examples:
        >>> record = logging.makeLogRecord({"msg": "job ended", "levelname": "INFO", "name": "x", "job": "77b2", "created": 0.0})
        >>> JsonLines().format(record)
        '{"time": "1970-01-01T00:00:00.000+00:00", "level": "INFO", "logger": "x", "message": "job ended", "job": "77b2"}'
    """

    def format(self, record: logging.LogRecord) -> str:
        """One line of the log."""
        line = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname,
            "logger": record.name,
            "message": record.getMessage(),
            **{key: value for key, value in vars(record).items() if key not in STANDARD},
        }
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


def install_logs() -> None:
    """Write the log of this process, those of uvicorn and Dask included."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines())
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    logging.getLogger("distributed").setLevel(logging.WARNING)
    logging.getLogger("alembic").setLevel(logging.WARNING)
