"""When readings were taken, as files and users write it."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from estimator.errors import InvalidInput, quoted

CLOCKS_APART = timedelta(days=1)  # a date later than that from now is a typing error


def moment(text: str, name: str, where: str = "") -> str:
    """An ISO 8601 date and time in UTC, to the second.

    Args:
        text: A date, or a date and a time; without a zone it is local time.
        name: Name of the quantity, for messages.
        where: File and line, or nothing, for messages.
    Raises:
        InvalidInput: It is no date, or lies in the future.
    Examples:
        >>> moment("2026-03-01T09:30:00+01:00", "--recorded-at")
        '2026-03-01T08:30:00+00:00'
    """
    place = f" ({where})" if where else ""
    try:
        time = datetime.fromisoformat(text.strip()).astimezone(UTC)
    except (ValueError, OverflowError):
        rule = f"{name} must be a date such as 2026-03-01 or 2026-03-01T09:30+01:00"
        raise InvalidInput(f"{rule}; received {quoted(text.strip())}{place}") from None
    if time > datetime.now(UTC) + CLOCKS_APART:
        raise InvalidInput(f"{name} must not lie in the future; received {quoted(text.strip())}{place}")
    return time.isoformat(timespec="seconds")
