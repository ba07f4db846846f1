"""The heart: what the simulation gets wrong in a session, which cause that has, the rig extended by it, and what is gained."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from estimator.calibration import write_text
from estimator.chain import Chain
from estimator.diagnosis.discrepancy import families
from estimator.diagnosis.extension import extended_text
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.gain import Gain, gain
from estimator.diagnosis.record import Fault, without_faults
from estimator.diagnosis.resolution import Visible, indistinguishable, smallest_visible
from estimator.diagnosis.search import Search, search
from estimator.diagnosis.verdict import NamedCause, Verdict, beside_discrepancy, named_causes, verdict_of
from estimator.effects import EFFECTS
from estimator.errors import InvalidInput
from estimator.preflight import check_readings
from estimator.records import Observations
from estimator.rig import Cause, Rig
from estimator.split import block_split
from estimator.store.session import Session

DIAGNOSIS, EXTENDED_RIG = "diagnosis.json", "rig_extended.yaml"
MORE_STARTS = 3
VALIDATION_SHARE = 0.2
MOST_SEARCHED, MOST_FITTED = 512, 3000  # readings in the search, and in the final fits


@dataclass(frozen=True)
class Diagnosis:
    """The verdict on a session.

    Attributes:
        rig: As it was described.
        verdict: The outcome.
        faults: Mistakes of the record that were undone first.
        causes: What was named after that, in order.
        search: How it was found, step by step.
        visible: Smallest visible size of every quantity of every cause.
        twins: Groups of causes that this session could not tell apart.
        fit: The extended rig, fitted to many readings.
        gain: On readings that were not used for fitting; None where there are none.
    """

    rig: Rig
    verdict: Verdict
    faults: tuple[Fault, ...]
    causes: tuple[NamedCause, ...]
    search: Search
    visible: tuple[Visible, ...]
    twins: tuple[tuple[Cause, ...], ...]
    fit: Fit
    gain: Gain | None
    extended_rig_text: str
    seed: int

    def label(self, cause: Cause) -> str:
        """Name of a cause; with its place where the rig has several."""
        places = EFFECTS[cause.name].places(self.rig)
        return cause.name if len(places) < 2 else cause.label

    def record(self) -> dict[str, Any]:
        """As `diagnosis.json` holds it (DESIGN section 5)."""
        result: dict[str, Any] = {
            "verdict": str(self.verdict),
            "causes": [
                *(self._fault(f) for f in self.faults),
                *(self._cause(c, self.fit) for c in self.causes),
            ],
            "indistinguishable": [[self.label(cause) for cause in group] for group in self.twins],
            "smallest_visible": self._visible(),
            "unexplained": {
                "log_bayes_factor": self.search.steps[-1].left.log_bayes_factor,
                "looks_like": self.search.steps[-1].left.family,
                "rms_sigma": self.search.steps[-1].left.rms_sigma,
            },
            "steps": [
                {
                    "taken": None if step.taken is None else self.label(step.taken),
                    "considered": [
                        {
                            "name": rival.name if rival.cause is None else self.label(rival.cause),
                            "log_bayes_factor": rival.log_bayes_factor,
                            "probability": rival.probability,
                        }
                        for rival in step.rivals
                    ],
                }
                for step in self.search.steps
            ],
            "dropped": [self.label(cause) for cause in self.search.dropped],
            "seed": self.seed,
        }
        if self.gain is not None:
            result["gain"] = {"before": self.gain.before.record(), "after": self.gain.after.record()}
            result["elpd_difference"], result["elpd_se"] = self.gain.elpd_difference, self.gain.elpd_se
            result["moved_sd"] = self.gain.moved_sd
        return result

    def save(self, folder: Path) -> None:
        """Write `diagnosis.json` and `rig_extended.yaml`."""
        write_text(folder / DIAGNOSIS, json.dumps(self.record(), indent=2, allow_nan=False) + "\n")
        write_text(folder / EXTENDED_RIG, self.extended_rig_text)

    def _cause(self, one: NamedCause, fit: Fit) -> dict[str, Any]:
        return {
            "name": self.label(one.cause),
            "place": one.cause.place,
            "probability": one.probability,
            "alternatives": [{"name": self.label(c), "probability": p} for c, p in one.alternatives],
            "log_bayes_factor": one.log_bayes_factor,
            "parameters": _parameters(one.cause, fit),
        }

    def _fault(self, fault: Fault) -> dict[str, Any]:
        weights = torch.softmax(torch.tensor([0.0, *(value for _, value in fault.twins)]), 0).tolist()
        others = zip((cause for cause, _ in fault.twins), weights[1:], strict=True)
        return {
            "name": self.label(fault.cause),
            "place": fault.cause.place,
            "probability": weights[0],
            "alternatives": [{"name": self.label(c), "probability": p} for c, p in others],
            "log_bayes_factor": fault.log_bayes_factor,
            "parameters": _parameters(fault.cause, self.fit),
        }

    def _visible(self) -> dict[str, dict[str, Any]]:
        return {
            f"{self.label(one.cause)}.{one.key}": {
                "size": one.size if one.is_visible else None,
                "unit": one.unit,
            }
            for one in self.visible
        }


def diagnose(
    session: Session,
    rig: Rig | None = None,
    *,
    validation: Session | None = None,
    out: Path | str | None = None,
    seed: int = 0,
    on_stage: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Find what the simulation gets wrong, name the cause, extend the rig and measure the gain.

    Args:
        session: Readings; those marked as validation judge the gain. Where none is marked, a fifth is kept out in blocks.
        rig: Another description of the session's rig.
        validation: Another session of the same rig to judge the gain by.
        out: Folder for `diagnosis.json` and `rig_extended.yaml`.
        seed: Of the split, the thinning and the starts.
        on_stage: Told what is going on.
    Returns: The verdict; `nothing_found`, `indistinguishable` and `unexplained` are outcomes, not errors.
    Raises:
        InvalidInput: The readings cannot support a fit.
    """
    tell = on_stage or (lambda words: None)
    rig = rig or session.rig
    session.check_rig(rig)
    if not rig.free:
        raise InvalidInput(f"rig must have at least one free parameter (a prior); rig {rig.name!r} has none")
    check_readings(rig, session.observations, session.source)
    seen, unseen = _split(session, validation, seed)
    few = _thinned(seen, MOST_SEARCHED, seed)

    tell("fit of the rig as it is described")
    chain = Chain.build(rig, few)
    plain = fit_rig(rig, few, {}, chain.rules, MORE_STARTS)
    tell("mistakes of the record")
    base, faults = without_faults(plain)
    tell("screening and naming of causes")
    found = search(base, tell)
    named = named_causes(found)
    verdict = verdict_of(found, named)
    if verdict is Verdict.UNEXPLAINED and named:
        named = beside_discrepancy(found, named, families(found.final))
    if verdict is Verdict.NOTHING_FOUND and faults:
        verdict = Verdict.INDISTINGUISHABLE if any(fault.twins for fault in faults) else Verdict.NAMED
    tell("gain on readings not used for fitting")
    before, after = plain, found.final
    if len(seen) > len(few):
        many = _thinned(seen, MOST_FITTED, seed)
        before, after = (fit_rig(fit.rig, many, fit.values, chain.rules) for fit in (plain, found.final))
    result = Diagnosis(
        rig,
        verdict,
        tuple(faults),
        tuple(named),
        found,
        tuple(smallest_visible(base, found.pool)),
        tuple(indistinguishable(base, found.pool)),
        after,
        gain(before, after, _thinned(unseen, MOST_FITTED, seed)) if len(unseen) else None,
        extended_text(rig, after),
        seed,
    )
    if out is not None:
        folder = Path(out)
        folder.mkdir(parents=True, exist_ok=True)
        result.save(folder)
    return result


def _split(session: Session, validation: Session | None, seed: int) -> tuple[Observations, Observations]:
    observations = session.observations
    if validation is not None:
        return observations.calibration, validation.observations
    if not bool(observations.is_validation.any()):
        observations = observations.with_validation(block_split(observations, VALIDATION_SHARE, seed))
    return observations.calibration, observations.validation


def _thinned(observations: Observations, most: int, seed: int) -> Observations:
    """At most so many of the readings, drawn at random."""
    if len(observations) <= most:
        return observations
    generator = torch.Generator().manual_seed(seed)
    return observations.rows(torch.randperm(len(observations), generator=generator)[:most].sort().values)


def _parameters(cause: Cause, fit: Fit) -> dict[str, dict[str, Any]]:
    """Median, width and interval of each quantity, by Laplace."""
    prefix = f"{cause.label}."
    result = {}
    for name, parameter in fit.rig.parameters.items():
        if name.startswith(prefix):
            value, sd = float(fit.values[name]), fit.value_sd(name) if parameter.is_free else 0.0
            result[name[len(prefix) :]] = {
                "median": value,
                "sd": sd,
                "ci90": [value - 1.644854 * sd, value + 1.644854 * sd],
                "unit": parameter.unit,
            }
    return result
