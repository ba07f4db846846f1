"""What studies of hidden causes share: cases in worker processes, one JSON row each, appended as it ends, so that a study continues."""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from estimator import Diagnosis, Session, diagnose, load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.handed_in import HiddenSession
from tests.hidden.study import credible_sets, label

Row = dict[str, Any]
Case = tuple[str, int]  # kind and seed


def _among(kinds: Sequence[str]) -> Callable[[str], str]:
    def check(text: str) -> str:
        for kind in text.split(","):
            if kind not in kinds:
                raise argparse.ArgumentTypeError(f"must be among {', '.join(kinds)}; received {kind!r}")
        return text

    return check


def options_of(
    words: str | None,
    kinds: Sequence[str],
    cases: int,
    first_seed: int,
    out: str,
    others: Sequence[str] = (),
) -> argparse.ArgumentParser:
    """Options that these studies have in common; the numbers are defaults, and other kinds may be asked for too."""
    parser = argparse.ArgumentParser(description=words)
    parser.add_argument("--cases", type=int, default=cases, help="number of cases of each kind")
    parser.add_argument("--kinds", default=",".join(kinds), type=_among((*kinds, *others)))
    parser.add_argument("--first-seed", type=int, default=first_seed)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path(out))
    return parser


def gather(options: argparse.Namespace, run: Callable[[str, int], Row]) -> list[Row]:
    """Rows of all cases that the options ask for; those that the file lacks are run. Diagnoses that failed are printed and left out."""
    seeds = range(options.first_seed, options.first_seed + options.cases)
    cases = [(kind, seed) for seed in seeds for kind in options.kinds.split(",")]
    rows = rows_of(cases, run, options.out, options.workers, line)
    failed = [row for row in rows if "error" in row]
    for row in failed:
        print(line(row))
    print(f"{len(failed)} of {len(cases)} diagnoses failed; they are in no share below")
    return [row for row in rows if "error" not in row]


def rows_of(
    cases: Sequence[Case],
    run: Callable[[str, int], Row],
    out: Path,
    workers: int,
    line_of: Callable[[Row], str],
) -> list[Row]:
    """Rows of some cases, in their order; those that a file lacks are run in processes of their own, and appended as they end.

    A case that fails has a row with its error.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    rows = read(out)
    missing = [case for case in cases if case not in rows]
    with (
        multiprocessing.get_context("spawn").Pool(workers, initializer=one_thread) as pool,
        out.open("a") as file,
    ):
        for i, row in enumerate(pool.imap_unordered(partial(_guarded, run), missing), start=1):
            file.write(json.dumps(row) + "\n")
            file.flush()
            rows[row["kind"], row["seed"]] = row
            print(f"{i} of {len(missing)}: {line_of(row)}", file=sys.stderr)
    return [rows[case] for case in cases]


def one_thread() -> None:
    """The workers share the cores as processes."""
    import torch

    torch.set_num_threads(1)


def _guarded(run: Callable[[str, int], Row], case: Case) -> Row:
    kind, seed = case
    try:
        return run(kind, seed)
    except Exception as error:  # a case that fails is a result of the study
        return {"kind": kind, "seed": seed, "error": f"{type(error).__name__}: {error}"}


def diagnosed(hidden: HiddenSession, seed: int) -> tuple[Diagnosis, float]:
    """The diagnosis, which sees only the rig file and the table of readings, and the seconds that it took."""
    return diagnosed_session(hidden, seed)[1:]


def diagnosed_session(hidden: HiddenSession, seed: int) -> tuple[Session, Diagnosis, float]:
    """The session as it was read, with its diagnosis and the seconds that this took."""
    session = session_of(hidden)
    begin = time.perf_counter()
    diagnosis = diagnose(session, seed=seed)
    return session, diagnosis, time.perf_counter() - begin


def session_of(hidden: HiddenSession) -> Session:
    """The session, read from its rig file and its table of readings."""
    with tempfile.TemporaryDirectory() as folder:
        hidden.write(Path(folder))
        return read_readings_csv(Path(folder) / "readings.csv", load_rig(Path(folder) / "rig.yaml"))


def row_of(kind: str, hidden: HiddenSession, diagnosis: Diagnosis, seconds: float) -> Row:
    """What every study keeps of a case."""
    record, truth = diagnosis.to_json(), hidden.truth()
    return {
        "kind": kind,
        "seed": hidden.seed,
        **{key: truth[key] for key in ("protocol", "motion", "is_tight") if key in truth},
        "truth": [{"label": label(cause), **cause} for cause in truth["causes"]],
        "noise_T": {name: value for name, value in truth["values"].items() if name.endswith("noise_T")},
        **{key: record[key] for key in ("verdict", "causes", "unexplained", "scatter")},
        "gain": record.get("gain"),
        "correction": record["correction"],
        "p_not_in_library": record.get("p_not_in_library"),
        "n_unseen": None if diagnosis.improvement is None else len(diagnosis.improvement.after.log_density),
        "seconds": seconds,
    }


def read(path: Path) -> dict[Case, Row]:
    """Rows that were appended so far."""
    if not path.exists():
        return {}
    return {(row["kind"], row["seed"]): row for row in map(json.loads, path.read_text().splitlines())}


def line(row: Row) -> str:
    """One case in a line."""
    if "error" in row:
        return f"{row['kind']} {row['seed']}: {row['error']}"
    sets = " + ".join(" or ".join(names) for names in credible_sets(row)) or "-"
    described = f"{row['protocol']} {row.get('motion', '')}".strip()
    return f"{row['kind']} {row['seed']} {described}: {truth_of(row) or 'nothing'} -> {row['verdict']}: {sets} ({row['seconds']:.1f} s)"


def truth_of(row: Row) -> str:
    """Names of the hidden causes."""
    return " + ".join(cause["label"] for cause in row["truth"])


def noise_T(row: Row) -> float:
    """True noise, as the rms length of a reading's error: what a perfect model leaves of unseen readings."""
    return math.sqrt(3.0 * sum(v**2 for v in row["noise_T"].values()) / len(row["noise_T"]))


def share(part: int, whole: int) -> str:
    """A share with its numbers."""
    return f"{part / max(whole, 1):.1%} ({part} of {whole})"


def share_and_interval(part: int, whole: int) -> str:
    """A share with its exact (Clopper-Pearson) 95 % interval."""
    if whole == 0:
        return share(part, whole)
    ends = binomtest(part, whole).proportion_ci(0.95, "exact")
    return f"{share(part, whole)}, 95 % interval {ends.low:.1%} to {ends.high:.1%}"
