"""Plots of calibrations, diagnoses and registries.

Every function draws into the given Axes, or into a new figure, and returns it. It never shows or saves.
"""

from estimator.reporting.plots.corner import corner
from estimator.reporting.plots.error_maps import (
    angular_deviation_map,
    before_and_after_map,
    relative_error_map,
    residual_map,
)
from estimator.reporting.plots.field_map import difference_plane, field_plane
from estimator.reporting.plots.history import history
from estimator.reporting.plots.hypotheses import (
    error_budget,
    evidence_bars,
    explained_residual,
    structure_bars,
)
from estimator.reporting.plots.posterior import interval_summary, traces
from estimator.reporting.plots.residuals import (
    predicted_against_measured,
    residual_against,
    residual_by_sensor,
    residual_histogram,
)
from estimator.reporting.plots.sessions import across_sessions
from estimator.reporting.plots.spectrum import harmonic_spectrum
from estimator.reporting.roles import Role

__all__ = [
    "Role",
    "across_sessions",
    "angular_deviation_map",
    "before_and_after_map",
    "corner",
    "difference_plane",
    "error_budget",
    "evidence_bars",
    "explained_residual",
    "field_plane",
    "harmonic_spectrum",
    "history",
    "interval_summary",
    "predicted_against_measured",
    "relative_error_map",
    "residual_against",
    "residual_by_sensor",
    "residual_histogram",
    "residual_map",
    "structure_bars",
    "traces",
]
