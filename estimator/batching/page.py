"""The page of a batch: agreement of parameters across sessions, fits, and failures."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from estimator.batching.jobs import PLAIN
from estimator.batching.result import BatchResult, most_probable
from estimator.calibration.calibrate import versions
from estimator.errors import listed
from estimator.reporting import plots
from estimator.reporting.numbers import displays, microtesla, percent, probability, with_sd
from estimator.reporting.page import Picture, ReportPage, Table, render_report

MOST_PARAMETERS = 12
MOST_LISTED = 6  # sessions that a sentence names
SCATTER_TOO_WIDE = 2.0  # chi-square per degree of freedom of a parameter across sessions


def overview(result: BatchResult, command: str) -> str:
    """HTML of a batch, self-contained.

    Args:
        result: Result of `estimator.batch`.
        command: The command that produced it, shown as provenance.
    """
    table = result.table()
    best = most_probable(table)
    names = _scalars(result)
    tables = [_across_sessions(best, names)] if len(best) > 1 and names else []
    tables += [_fits(table)] if len(table) else []
    page = ReportPage(
        title=f"Batch of {table['session_hash'].nunique() if len(table) else 0} sessions",
        subtitle=str(result.folder.parent),
        verdict=_verdict(result, table, best, names),
        warnings=_warnings(result, table),
        tables=tables,
        figures=[_picture(result, best, names)] if len(best) and names else [],
        provenance={
            "command": command,
            "versions": ", ".join(f"{name} {v}" for name, v in versions().items()),
        },
    )
    return render_report(page)


def _scalars(result: BatchResult) -> list[str]:
    """Parameters common to all jobs, in the order of the rig."""
    records = result.records()
    common = set.intersection(*(set(record["parameters"]) for record in records)) if records else set()
    return [name for name in (records[0]["parameters"] if records else ()) if name in common][
        :MOST_PARAMETERS
    ]


def _scatter(best: pd.DataFrame, name: str) -> float:
    """Chi-square per degree of freedom of one parameter across sessions; about 1 if they agree within their intervals."""
    centre, sd = best[name].to_numpy(), best[f"{name}.sd"].to_numpy()
    if len(centre) < 2 or not (sd > 0.0).all():
        return float("nan")
    return float((((centre - _mean(centre, sd)) / sd) ** 2).sum() / (len(centre) - 1))


def _mean(centre: np.ndarray, sd: np.ndarray) -> float:
    """Mean weighted by the intervals, or the plain mean if one has no width, as for a certain loop count."""
    return float(np.average(centre, weights=sd**-2.0) if (sd > 0.0).all() else centre.mean())


def _verdict(result: BatchResult, table: pd.DataFrame, best: pd.DataFrame, names: Sequence[str]) -> list[str]:
    n_sampled = int(table["is_sampled"].sum()) if len(table) else 0
    failures = f", {len(result.failed)} failed" if result.failed else ""
    fits = "1 fit" if len(table) == 1 else f"{len(table)} fits"
    sentences = [*_wrong(best), f"{fits}, {n_sampled} of them sampled{failures}."]
    if len(best) > 1:
        disagreeing = [name for name in names if _scatter(best, name) > SCATTER_TOO_WIDE]
        words = displays(names)
        sentences.append(
            "Sessions differ by more than their intervals in "
            + ", ".join(words[name].words for name in disagreeing)
            + "."
            if disagreeing
            else "What all of them have in common agrees across sessions within its intervals."
        )
    if len(best) and table["hypothesis"].nunique() > 1 and not _wrong(best):
        counts = best["hypothesis"].value_counts()
        sentences.append("Most probable: " + ", ".join(f"{name} in {n}" for name, n in counts.items()) + ".")
    return sentences


def _wrong(best: pd.DataFrame) -> list[str]:
    """A sentence for each hypothesis that is most probable in some session and is not the rig as described."""
    if not len(best):
        return []
    short = _short(best["session"])
    sentences = []
    for name, rows in best[best["hypothesis"] != PLAIN].groupby("hypothesis", sort=False):
        where = [
            " ".join(
                filter(None, (short[row["session"]], row["coil"], f"({probability(row['probability'])})"))
            )
            for _, row in rows.head(MOST_LISTED).iterrows()
        ]
        sentences.append(
            f"Most probable is {name} in {listed(where, len(rows))}: look at it with coilcal diagnose."
        )
    return sentences


def _warnings(result: BatchResult, table: pd.DataFrame) -> list[str]:
    warnings = [f"{Path(what).name}: {why}" for what, why in result.failed.items()]
    warnings += [f"{caution[:1].upper()}{caution[1:]}." for caution in result.cautions()]
    if len(table):
        warnings += [
            f"{job} did not converge; its intervals are provisional."
            for job in table["job"][~table["is_converged"]]
        ]
    return warnings


def _across_sessions(best: pd.DataFrame, names: Sequence[str]) -> Table:
    words = displays(names)
    rows = []
    for name in names:
        show, sd = words[name], best[f"{name}.sd"].to_numpy()
        mean, ratio = _mean(best[name].to_numpy(), sd), _scatter(best, name)
        rows.append(
            [
                show.words,
                with_sd(mean * show.factor, float(best[name].std()) * show.factor),
                f"{float(np.median(sd)) * show.factor:.2g}",
                show.unit or "1",
                f"{ratio:.3g}" if np.isfinite(ratio) else "—",
            ]
        )
    header = ["parameter", "mean ± scatter", "median sd of one session", "unit", "χ² per degree of freedom"]
    caption = "A χ² well above 1 means that sessions differ by more than their uncertainties."
    return Table("Across sessions", header, rows, caption)


def _fits(table: pd.DataFrame) -> Table:
    short = _short(table["session"])
    rows = [
        [
            short[row["session"]] + (f", {row['coil']}" if row["coil"] else ""),
            str(row["hypothesis"]),
            f"{row['log_evidence']:.1f}",
            percent(row["probability"], 1),
            microtesla(row["calibration_rmse_T"]),
            microtesla(row["validation_rmse_T"]) if pd.notna(row["validation_rmse_T"]) else "—",
            "sampled" if row["is_sampled"] else "Laplace",
            row["verdict"] or "—",
        ]
        for _, row in table.iterrows()
    ]
    errors = ["error of the fit", "of validation"]
    header = ["session", "hypothesis", "log evidence", "probability", *errors, "intervals", "verdict"]
    return Table("Fits", header, rows, "Errors are the rms of the vector.")


def _picture(result: BatchResult, best: pd.DataFrame, names: Sequence[str]) -> Picture:
    arrays = result.dataset().sel(job=best["job"].to_list(), parameter=list(names))
    short = _short(best["session"])
    labels = [short[s] + (f" {c}" if c else "") for s, c in zip(best["session"], best["coil"], strict=True)]
    figure = plots.across_sessions(
        names,
        arrays["median"].to_numpy(),
        arrays["ci90"].to_numpy(),
        labels,
        best["is_sampled"].to_numpy(dtype=bool),
    )
    caption = "Median and 90 % interval of each session: blue by sampling, grey by Laplace; the line is the mean of all."
    return Picture("Parameters, session by session", caption, figure)


def _short(paths: Iterable[str]) -> dict[str, str]:
    """Short name of each session by its path, with the folders in which paths differ if two share a name.

    Examples:
        >>> _short(["/data/a/day1.zarr", "/data/b/day1.zarr"])
        {'/data/a/day1.zarr': 'a/day1', '/data/b/day1.zarr': 'b/day1'}
        >>> _short(["/data/a/day1.zarr", "/data/a/day2.zarr"])
        {'/data/a/day1.zarr': 'day1', '/data/a/day2.zarr': 'day2'}
    """
    unique = list(dict.fromkeys(paths))
    stems = [Path(path).stem for path in unique]
    if len(set(stems)) == len(stems):
        return dict(zip(unique, stems, strict=True))
    common = os.path.commonpath(unique)
    return {path: str(Path(path).relative_to(common).with_suffix("")) for path in unique}
