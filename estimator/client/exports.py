"""A calibration at a service as a file for other programs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estimator.client.predictions import Currents, Motion
from estimator.client.steps import Steps, send
from estimator.store.staging import write_output

if TYPE_CHECKING:
    from estimator.export.request import Grid


def exported(
    calibration_id: str,
    to: str,
    path: Path | str | None,
    grid: Grid | None,
    currents_A: Currents | None,
    motion: Motion | None,
) -> Steps[Path]:
    """The file that holds a calibration in a format of `coilcal export`.

    Raises:
        InvalidInput: As `estimator.Calibration.export`.
    """
    body: dict[str, Any] = {"to": to, "currents_A": dict(currents_A or {})}
    body["motion"] = {name: values.tolist() for name, values in (motion or {}).items()}
    if grid is not None:
        axes: Mapping[str, Any] = {"x_m": grid.x_m, "y_m": grid.y_m, "z_m": grid.z_m}
        body["grid"] = {name: coordinates_m.tolist() for name, coordinates_m in axes.items()}
    answer = yield from send("POST", f"/v1/calibrations/{calibration_id}/export", json=body)
    usual_name = Path(answer.headers["Content-Disposition"].partition('filename="')[2].rstrip('"')).name
    path = Path(usual_name if path is None else path)
    write_output(path, answer.content, overwrite=True)
    return path
