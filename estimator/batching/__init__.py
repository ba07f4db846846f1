"""Many sessions at once: every session, coil and hypothesis fitted on a cluster, the probable hypotheses sampled."""

from estimator.batching.result import BatchResult
from estimator.batching.run import batch

__all__ = ["BatchResult", "batch"]
