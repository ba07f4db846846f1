"""Results of a batch: a table of all fits, the probabilities of the hypotheses, the sampled posteriors."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from estimator.batching.work import CALIBRATION_FOLDER, RESULT_FILE
from estimator.calibration.files import POSTERIOR_STORE, SUMMARY_FILE
from estimator.calibration.result import Calibration
from estimator.errors import CorruptStore, InvalidInput
from estimator.json_files import read_json
from estimator.store.files import write_bytes, write_text


@dataclass(frozen=True)
class BatchResult:
    """The results of a batch on disk.

    Attributes:
        folder: Folder with one folder for each job.
        names: Names of the fitted jobs.
        failed: Reason for each session or job without a result.
        n_new: Number of fits and posteriors made by this call.
        sessions: Present path of the session of each job; by default its path at the time of the fit.
    """

    folder: Path
    names: tuple[str, ...]
    failed: dict[str, str]
    n_new: int = 0
    sessions: Mapping[str, str] = field(default_factory=dict)

    def records(self) -> list[dict[str, Any]]:
        """Content of every `result.json`, with the parameters of the posterior if it was sampled."""
        return [
            {**record, "session": self.sessions.get(name, record["session"])}
            for name, record in ((name, _result(self.folder / name)) for name in self.names)
        ]

    def table(self) -> pd.DataFrame:
        """One row for each job, with its parameters in columns `NAME`, `NAME.sd`, `NAME.low` and `NAME.high` (90 %).

        `verdict` says whether the posterior can be used (`good`, `suspect` or `unusable`); it is empty where none was sampled.
        """
        rows = []
        for name, record in zip(self.names, self.records(), strict=True):
            row = {
                "job": name,
                "session": record["session"],
                "coil": record["coil"],
                "hypothesis": record["hypothesis"],
                "log_evidence": record["log_evidence"],
                "is_sampled": record["is_sampled"],
                "is_converged": record["is_converged"],
                "verdict": record["verdict"],
                "calibration_rmse_T": record["vector_rmse_T"]["calibration"],
                "validation_rmse_T": record["vector_rmse_T"]["validation"],
                "session_hash": record["session_hash"],
            }
            for key, numbers in record["parameters"].items():
                low, high = numbers["ci90"]
                row |= {
                    key: numbers["median"],
                    f"{key}.sd": numbers["sd"],
                    f"{key}.low": low,
                    f"{key}.high": high,
                }
            rows.append(row)
        table = pd.DataFrame(rows)
        if len(table):
            position = table.columns.get_loc("log_evidence")
            assert isinstance(position, int)
            table.insert(position + 1, "probability", probabilities(table))
        return table

    def cautions(self) -> list[str]:
        """Sentences on the most probable hypotheses whose posteriors are not good, or were not sampled and so not judged."""
        best = most_probable(self.table())
        if not len(best):
            return []
        sentences = [
            f"{verdict} ({n} of {len(best)}): intervals hold only if nothing is wrong, which coilcal diagnose looks for"
            for verdict, n in best["verdict"].value_counts().items()
            if verdict != "good"
        ]
        n_not = int(best["verdict"].isna().sum())
        return (
            [*sentences, f"not judged ({n_not} of {len(best)}): no posterior was sampled"]
            if n_not
            else sentences
        )

    def save_table(self, folder: Path) -> None:
        """Write the table as `summary.csv`, with all digits, and as `summary.parquet`."""
        table = self.table()
        write_text(folder / "summary.csv", table.to_csv(index=False, lineterminator="\n"))
        parquet = io.BytesIO()
        table.to_parquet(parquet, index=False)
        write_bytes(folder / "summary.parquet", parquet.getvalue())

    def dataset(self) -> xr.Dataset:
        """Medians, standard deviations and intervals by job and parameter; NaN where a job lacks the parameter."""
        records = self.records()
        names = sorted({name for record in records for name in record["parameters"]})
        absent = {"median": np.nan, "sd": np.nan, "ci90": [np.nan, np.nan]}
        numbers = [[record["parameters"].get(name, absent) for name in names] for record in records]
        shape = (len(records), len(names))
        columns = {
            key: np.array([[p[key] for p in row] for row in numbers], dtype=float) for key in ("median", "sd")
        }
        ends = np.array([[p["ci90"] for p in row] for row in numbers], dtype=float).reshape(*shape, 2)
        return xr.Dataset(
            {
                **{key: (("job", "parameter"), values.reshape(shape)) for key, values in columns.items()},
                "ci90": (("job", "parameter", "end"), ends),
            },
            {
                "job": list(self.names),
                "parameter": names,
                "end": ["low", "high"],
                "session": ("job", [record["session"] for record in records]),
                "coil": ("job", [record["coil"] or "" for record in records]),
                "hypothesis": ("job", [record["hypothesis"] for record in records]),
            },
        )

    def calibration(self, name: str) -> Calibration:
        """The sampled posterior of a job.

        Raises:
            InvalidInput: The posterior was not sampled.
        """
        return Calibration.load(self._sampled(name))

    def tree(self, name: str) -> xr.DataTree:
        """The sampled posterior of a job in ArviZ's groups.

        Raises:
            InvalidInput: The posterior was not sampled.
        """
        return xr.open_datatree(self._sampled(name) / POSTERIOR_STORE, engine="zarr", consolidated=False)

    def _sampled(self, name: str) -> Path:
        if not (self.folder / name / CALIBRATION_FOLDER / SUMMARY_FILE).exists():
            raise InvalidInput(f"posterior of job {name!r} must have been sampled; it was not")
        return self.folder / name / CALIBRATION_FOLDER


def most_probable(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of a table with the most probable hypothesis of each session and coil."""
    if not len(table):
        return table
    groups = [table["session_hash"], table["coil"].fillna("")]
    return table.loc[table.groupby(groups, sort=False)["log_evidence"].idxmax()]


def probabilities(table: pd.DataFrame) -> pd.Series[float]:
    """Posterior probability of each hypothesis among those of the same session and coil, with equal prior probabilities."""
    groups = [table["session_hash"], table["coil"].fillna("")]
    best = table["log_evidence"].groupby(groups).transform("max")
    weight = (table["log_evidence"] - best).map(math.exp)
    return weight / weight.groupby(groups).transform("sum")


def _result(folder: Path) -> dict[str, Any]:
    result = read_json(folder / RESULT_FILE, fault=CorruptStore)
    summary_file = folder / CALIBRATION_FOLDER / SUMMARY_FILE
    result["is_sampled"], result["verdict"] = summary_file.exists(), None
    if result["is_sampled"]:
        summary = read_json(summary_file, fault=CorruptStore)
        result["parameters"] = {
            name: {key: numbers[key] for key in ("median", "sd", "ci90", "unit")}
            for name, numbers in summary["parameters"].items()
        }
        result["is_converged"] = summary["is_converged"]
        result["verdict"] = summary.get("quality", {}).get("verdict")
    return result
