"""What can go wrong beside `InvalidInput`, with which the service's own refusals are raised."""

from __future__ import annotations

from estimator.errors import CoilcalError


class ServiceFault(CoilcalError):
    """The service cannot be reached, or failed."""


class JobFailed(CoilcalError):
    """A job ended without a result; the message is the sentence of the service."""
