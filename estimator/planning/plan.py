"""A plan before any reading: which stops, how often, in which order, why each, and what to expect of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from estimator.acquisition.pace import Pace, default_pace
from estimator.diagnosis.next_readings.stops import CHOOSING
from estimator.diagnosis.progress import OnCount, uncounted
from estimator.effects.everywhere import with_everywhere
from estimator.errors import InvalidInput
from estimator.planning.candidates import clear_candidates, fitted_rig, largest_currents_A
from estimator.planning.design import Design
from estimator.planning.goals import goal_of
from estimator.planning.information import N_DRAWS, Expected, draws_of_prior, refuse_unreachable
from estimator.planning.planned import Planned, Visits
from estimator.readings.plan import Plan
from estimator.rig.rig import Rig

MOST_STOPS = 500  # that a plan looks for by itself
# Shares of the stops, at least one each where there are a dozen
VALIDATION_SHARE, ZERO_SHARE, AGAIN_SHARE = 0.12, 0.05, 0.1


def plan(
    rig: Rig,
    places: Plan,
    goals: Sequence[str] = (),
    *,
    n_stops: int | None = None,
    pace: Pace | None = None,
    order: str = "tour",
    seed: int = 0,
    on_count: OnCount = uncounted,
) -> Planned:
    """Plan a measurement before any reading.

    Args:
        rig: With priors.
        places: Poses and currents among which stops are chosen, each pose with each current.
        goals: What shall be known, such as `field 0.2 % in box x_mm=-50:50 y_mm=-50:50 z_mm=-25:25`; without one, all free parameters
            together (D-optimal).
        n_stops: Number of stops; by default as many as the goals need.
        pace: Speeds and times, from which minutes follow; arms at 100 mm/s by default.
        order: `tour` for the shortest way, `random` where drift is to be told from place.
        seed: Of the draws of the prior and of all random orders.
        on_count: Called as stops are chosen.
    Raises:
        InvalidInput: A goal cannot be read, or no number of these stops reaches it; the sentence says what would be reached.

    Examples:
        >>> from estimator import load_plan, load_rig, plan
        >>> rig = load_rig("configs/paper_simulation.yaml")
        >>> places = load_plan("configs/plans/paper_grid.yaml", rig)
        >>> planned = plan(rig, places, ["field 1 % in box x_mm=-50:50 y_mm=-50:50 z_mm=-25:25"], n_stops=24)
        >>> len(planned.stops), int(planned.stops.is_validation.sum())
        (24, 3)
    """
    if n_stops is None and not goals:
        raise InvalidInput("a plan must be given a number of stops or a goal; received neither")
    pace = pace or default_pace(rig, places.settle_s)
    stops, described = clear_candidates(places, rig, seed), rig
    rig = fitted_rig(rig, stops, goals)
    parsed = [goal_of(text, rig, largest_currents_A(rig, stops)) for text in goals]
    expected = Expected.of(rig, stops, parsed, draws_of_prior(rig, N_DRAWS, seed))
    refuse_unreachable(expected, parsed)
    design = Design(expected)
    on_count(CHOOSING, 0, n_stops or MOST_STOPS)
    visits = Visits(design, stops, parsed, rig, pace, seed)
    planned = visits.planned(order, *_grow(design, n_stops, visits.n_settings_off, on_count))
    missing = with_everywhere(described, planned.stops.calibration).missing
    return replace(planned, not_told=tuple(cause.label for cause in missing if cause not in rig.acting))


def _grow(design: Design, n_stops: int | None, n_off: int, on_count: OnCount) -> tuple[int, int, int]:
    """Choose the stops that inform, and say how many of other kinds there shall be: validation, zero current, again.

    Raises:
        InvalidInput: The goals need more than `MOST_STOPS` stops.
    """
    n_unknown = design.precision.shape[-1]

    def others(n: int) -> tuple[int, int, int]:
        shares = (VALIDATION_SHARE, ZERO_SHARE, AGAIN_SHARE)
        n_validation, n_zero, n_again = (round(share * n) or int(n >= 12) for share in shares)
        return n_validation, min(n_zero, n_off), n_again

    if n_stops is not None:
        design.grow(max(1, n_stops - sum(others(n_stops))))
    while n_stops is None and (len(design.chosen) < n_unknown or bool((design.widths > 1.0).any())):
        design.grow(len(design.chosen) + max(1, len(design.chosen) // 20))
        on_count(CHOOSING, len(design.chosen), MOST_STOPS)
        if len(design.chosen) > MOST_STOPS:
            raise InvalidInput(
                f"goals must need at most {MOST_STOPS} stops; these leave {float(design.widths.max()):.2g} times the half-width "
                "(give --stops for more)"
            )
    design.exchange()
    return others(n_stops or math.ceil(len(design.chosen) / (1.0 - VALIDATION_SHARE - ZERO_SHARE)))
