"""Fields and places that were written down wrongly in some rows: which rows are flagged, and which are flagged though they are right.

Kinds of `tests/hidden/written_wrong.py` spoil sessions in which nothing else is wrong; the kinds `clean`, `single`, `discrete`,
`outside`, `unknown30` and `unforeseen30` are sessions of the other studies, in which no single row is wrong. Here a fit is asked in every
session; a diagnosis asks it only where readings miss by far. So are measured maps, where COILCAL_DATA names their folder.
`make written-wrong` runs it.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from estimator import load_rig
from estimator.diagnosis import effort
from estimator.diagnosis.expectation import predict_T
from estimator.diagnosis.first_fit import FirstFit
from estimator.diagnosis.fitting import fit_rig
from estimator.diagnosis.hypotheses.far_elsewhere import rules_and_refusal
from estimator.diagnosis.result import Question
from estimator.diagnosis.single_readings import suspects_of
from estimator.effects import EFFECTS
from estimator.readings.observations import Observations
from estimator.store.importers.readings_csv import read_readings_csv
from estimator.store.session import Session
from scripts.studies.diagnose_real import MICE, MORE, session_of
from scripts.studies.hidden_cases import one_thread
from scripts.studies.real_data import DATA_SETS
from tests.hidden.handed_in import HiddenSession
from tests.hidden.session import draw_session
from tests.hidden.study import PROTOCOLS, draw_case
from tests.hidden.written_wrong import KINDS, LATER_KINDS, LATER_PLACES, PLACES, placed, unsigned, written

RIGHT_KINDS = ("clean", "single", "discrete", "outside", "unknown30", "unforeseen30")
UNSIGNED = "unsigned_currents"
OF_PLACES = (*PLACES, *LATER_PLACES)
ALL_KINDS = (*KINDS, *LATER_KINDS, *OF_PLACES, UNSIGNED, *RIGHT_KINDS)
CLEAR_SIGMA = 20.0  # of the noise by which a wrong row differs clearly from what was measured


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=40, help="sessions of each kind")
    parser.add_argument("--first-seed", type=int, default=92_000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--kinds", nargs="+", choices=ALL_KINDS, default=ALL_KINDS)
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.cases)
    print("kind           sessions  clearly wrong rows, flagged  flagged whole  right rows flagged")
    with multiprocessing.get_context("spawn").Pool(options.workers, initializer=one_thread) as pool:
        for kind in options.kinds:
            cases = pool.map(partial(run_case, kind), seeds, chunksize=1)
            clear = [case for case in cases if case.clear]
            found = f"{sum(case.found for case in clear)} of {sum(case.clear for case in clear)}"
            whole = f"{sum(case.found == case.clear for case in clear)} of {len(clear)}"
            false = [case.false for case in cases if case.false]
            right = f"{sum(false)} in {len(false)} sessions" if false else "none"
            if kind in RIGHT_KINDS:
                found = whole = ""
            print(f"{kind:14} {len(cases):8}  {found:>27}  {whole:>13}  {right}", flush=True)
    if data := os.environ.get("COILCAL_DATA"):
        sets = {data_set.name: data_set for data_set in (*DATA_SETS, *MORE, *MICE)}.values()
        flagged = [len(_flagged(session_of(data_set, Path(data)))) for data_set in sets]
        print(f"measured maps: {len(flagged)}; readings that are flagged: {sum(flagged)}")


class Case(NamedTuple):
    """Rows of one session that are clearly wrong, how many of them are flagged, and how many right ones."""

    clear: int
    found: int
    false: int


def run_case(kind: str, seed: int) -> Case:
    """One session of a kind, drawn from the seed."""
    if kind in RIGHT_KINDS:
        return Case(0, 0, len(_flagged(_imported(draw_case(kind, seed, EFFECTS)))))
    hidden = draw_session(seed, None, protocol=PROTOCOLS[seed % 2])
    session = _imported(hidden)
    sigma_T = float(hidden.scene.noise_T[0])
    if kind == UNSIGNED:
        observations, wrong, clear = _unsigned(session, sigma_T, seed)
    else:
        spoil = _misplaced if kind in OF_PLACES else _spoilt
        observations, wrong, clear = spoil(kind, session, sigma_T, seed)
    flagged = _flagged(replace(session, observations=observations))
    return Case(len(clear), len(clear & flagged), len(flagged - wrong))


def _imported(hidden: HiddenSession) -> Session:
    with tempfile.TemporaryDirectory() as folder:
        hidden.write(Path(folder))
        return read_readings_csv(Path(folder) / "readings.csv", load_rig(Path(folder) / "rig.yaml"))


def _spoilt(
    kind: str, session: Session, sigma_T: float, seed: int
) -> tuple[Observations, set[int], set[int]]:
    """Readings of the first sensor written down wrongly; numbers of the wrong ones, and of those that are clearly so."""
    observations = session.observations
    own = np.flatnonzero(observations.sensor.numpy() == 0)
    field_T = observations.field_sensor_T.numpy().copy()
    measured_T = field_T[own].copy()
    made = written(kind, measured_T, np.random.default_rng([17, seed]))
    field_T[own] = made.field_T
    is_clear = np.abs(made.field_T - measured_T).max(axis=1) > CLEAR_SIGMA * sigma_T
    clear = own[np.intersect1d(made.wrong, np.flatnonzero(is_clear))]
    spoilt = observations.with_field(torch.from_numpy(field_T))
    return spoilt, set(own[made.wrong].tolist()), set(clear.tolist())


def _unsigned(session: Session, sigma_T: float, seed: int) -> tuple[Observations, set[int], set[int]]:
    """Currents written down without their sign; numbers of the rows where it is another one, and of those where the field tells it."""
    right = session.observations
    field_T = right.field_sensor_T.numpy()
    made_T, current_A, rows = unsigned(
        field_T, right.current_A[:, 0].numpy(), np.random.default_rng([19, seed])
    )
    recorded_A = right.current_A.clone()
    recorded_A[:, 0] = torch.from_numpy(current_A)
    spoilt = replace(right.with_field(torch.from_numpy(made_T)), current_A=recorded_A)
    is_clear = 2.0 * np.nanmax(np.abs(field_T), axis=1) > CLEAR_SIGMA * sigma_T
    return spoilt, set(rows.tolist()), set(np.intersect1d(rows, np.flatnonzero(is_clear)).tolist())


def _misplaced(
    kind: str, session: Session, sigma_T: float, seed: int
) -> tuple[Observations, set[int], set[int]]:
    """Places written down wrongly; numbers of the wrong rows, and of those where a fit to the right ones expects clearly another field."""
    right = session.observations
    motion = right.motion["arm1"].clone()
    made = placed(kind, motion[:, :3].numpy(), np.random.default_rng([18, seed]))
    motion[:, :3] = torch.from_numpy(made.place_m)
    spoilt = replace(right, motion={**right.motion, "arm1": motion})
    rules, _ = rules_and_refusal(session.rig, right)
    fit = fit_rig(session.rig, right.calibration, {}, rules)
    off_T = (predict_T(fit, fit.values, spoilt) - right.field_sensor_T).abs().amax(dim=1)
    wrong = set(made.wrong.tolist())
    return spoilt, wrong, wrong & set((off_T > CLEAR_SIGMA * sigma_T).nonzero().flatten().tolist())


def _flagged(session: Session) -> set[int]:
    """Numbers of the readings that are flagged by their digits and by a fit of the rig as described."""
    first = FirstFit.of(
        Question(session.rig, session.source, 0), session, None, effort.MOST_READINGS_SEARCHED
    )
    flags = [*first.flags, *suspects_of(first.plain, first.session.observations).flags]
    return {reading for flag in flags if not flag.is_everywhere for reading in flag.readings}


if __name__ == "__main__":
    main()
