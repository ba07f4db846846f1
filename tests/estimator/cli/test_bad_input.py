"""Whatever a hurried user gets wrong: one sentence, exit code 2, and nothing written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from estimator.store.staging import only_writer, staged
from tests.estimator.cli.conftest import refused, run

SIMULATE = "simulate --rig rig.yaml --plan plan.yaml"
IMPORT = "import readings.csv --rig rig.yaml"
PREDICT = "predict calibration --out new.csv --current coil1=2"
EXISTS = "output must not exist yet, or be replaced with --overwrite; received"
GRID = "--grid must look like x_mm=-50:50:11, which is 11 points from -50 to 50, or z_mm=20; received"
TRUTH = "--truth must be prior, nominal or a JSON file {{parameter: number}}"
NO_CALIBRATION = "calibration must be a folder that coilcal calibrate finished (with summary.json); received"
NO_SESSION = "session must be a folder that coilcal import, simulate or acquire wrote; received"

REFUSALS = {
    f"{SIMULATE} --out simulated.zarr": f"{EXISTS} simulated.zarr",
    f"{SIMULATE} --out new.zarr --csv readings.csv": f"{EXISTS} readings.csv",
    f"{SIMULATE} --out . --overwrite": "output must not hold what is read; . holds rig.yaml: take another",
    f"{SIMULATE} --out calibration --overwrite": "only a session is replaced by a session; calibration is something else",
    f"{SIMULATE} --out rig.yaml --overwrite": "output must be another path than what is read; received rig.yaml for both",
    f"{SIMULATE} --out rig.yaml/new.zarr": "output must be writable; {here}/rig.yaml/new.zarr is not: Not a directory",
    f"{SIMULATE} --out new.zarr --csv rig.yaml/new.csv": "output must be writable; rig.yaml/new.csv is not: Not a directory",
    f"{SIMULATE} --out {'x' * 300}": f"{'x' * 300} must be readable and writable: File name too long",
    f"{SIMULATE} --out new.zarr --set coil1.radius=0.05": "rig 'small' has no parameter 'coil1.radius'; the closest is coil1.radius_m",
    f"{SIMULATE} --out new.zarr --set coil1.radius_m=-1": "truth: coil1.radius_m must be > 0; received -1 m (rig 'small')",
    f"{SIMULATE} --out new.zarr --set coil1.radius_m=51mm": "--set must look like NAME=1.0; received 'coil1.radius_m=51mm'",
    f"{SIMULATE} --out new.zarr --set coil1.radius_m": "--set must look like NAME=1.0; received 'coil1.radius_m'",
    f"{SIMULATE} --out new.zarr --set coil1.radius_m=nan": "--set must look like NAME=1.0; received 'coil1.radius_m=nan'",
    f"{SIMULATE} --out new.zarr --set hall.noise_T=0 --set hall.noise_T=1": "--set must name hall.noise_T once; "
    "received it again in 'hall.noise_T=1'",
    f"{SIMULATE} --out new.zarr --truth no.json": f"{TRUTH}; no.json must be readable: No such file or directory",
    f"{SIMULATE} --out new.zarr --truth rig.yaml": f"{TRUTH}; rig.yaml must be JSON; expecting value at line 1, column 1",
    f"{SIMULATE} --out new.zarr --truth words.json": "--truth must give numbers between -1e+12 and 1e+12; received '51 mm' for 'coil1.radius_m' (words.json)",
    "simulate --rig no.yaml --plan plan.yaml --out new.zarr": "no.yaml must be readable as text: No such file or directory",
    "simulate --rig calibration --plan plan.yaml --out new.zarr": "calibration must be readable as text: Is a directory",
    "simulate --rig readings.csv --plan plan.yaml --out new.zarr": "readings.csv must hold keys and values; it holds a list or text",
    "simulate --rig plan.yaml --plan plan.yaml --out new.zarr": "coils must name at least one; received none (plan.yaml, line 1)",
    "simulate --rig rig.yaml --plan rig.yaml --out new.zarr": "poses is missing (rig.yaml, line 1)",
    f"{IMPORT} --out session.zarr": f"{EXISTS} session.zarr",
    f"{IMPORT} --out new.zarr --current coil1=3": "coil1_current must be given once; the file has it, and a constant too (readings.csv)",
    f"{IMPORT} --out new.zarr --current coil1": "--current must look like NAME=1.0; received 'coil1'",
    f"{IMPORT} readings.csv --out new.zarr": "the format readings takes one file, each row with place, currents and field; "
    "received 2: put them into one",
    "import no.csv --rig rig.yaml --out new.zarr": "no.csv must be readable as text: No such file or directory",
    "import session.zarr --rig rig.yaml --out new.zarr": "session.zarr must be readable as text: Is a directory",
    "import rig.yaml --rig rig.yaml --out new.zarr": "rig.yaml must hold a header and rows of numbers; "
    "no line holds two numbers between commas, semicolons, tabs or blanks: export it as CSV",
    "import whole.csv --rig rig.yaml --out new.zarr --validation 20": "validation share must be at least 0 and below 1; received 20",
    "import whole.csv --rig rig.yaml --out new.zarr --validation 0.9999": "session must hold calibration readings; "
    "it holds none (whole.csv)",
    "import mm.csv --rig rig.yaml --out new.zarr": "positions of the movers must be in the unit that is stated; they look like mm called m, "
    "or um called mm: divided by 1000 they fit the rig's nominal model; if so, name them so in the file, "
    "or with --column 'HEADER=arm1_x_mm' or 'HEADER=arm1_x_um' when they are imported (mm.csv)",
    "import off.csv --rig rig.yaml --out new.zarr": "at least one coil must carry current; all currents are 0 A (off.csv)",
    "import still.csv --rig rig.yaml --out new.zarr": "readings must be taken at several poses; all 20 share one (still.csv)",
    "import one.csv --rig rig.yaml --out new.zarr": "a calibration needs readings at several poses; received a single reading (one.csv)",
    "calibrate readings.csv --out new": f"{NO_SESSION} readings.csv",
    "calibrate no.zarr --out new": f"{NO_SESSION} no.zarr",
    "calibrate calibration/chain.zarr --out new": "session must be of kind 'coilcal session'; received None (calibration/chain.zarr)",
    "calibrate session.zarr --out calibration": "output must not hold a finished calibration unless --overwrite replaces it; "
    "received calibration",
    "calibrate session.zarr --out new --walkers 2": "walkers must be at least 6 for 3 free parameters; received 2",
    "calibrate session.zarr --out rig.yaml": "output must be writable; rig.yaml is not: Not a directory",
    "calibrate session.zarr --out rig.yaml/new": "output must be writable; rig.yaml/new is not: Not a directory",
    "calibrate session.zarr --out new --rig no.yaml": "no.yaml must be readable as text: No such file or directory",
    "calibrate session.zarr --out calibration --overwrite --rig other.yaml": "movers of the rig must be those of the session "
    "(arm1 (displacement)); received arm2 (displacement) (rig 'small')",
    "predict session.zarr --out new.csv --grid x_mm=0 --current coil1=2": f"{NO_CALIBRATION} session.zarr",
    "predict no --out new.csv --grid x_mm=0 --current coil1=2": f"{NO_CALIBRATION} no",
    "predict calibration --out field.csv --grid x_mm=0 --current coil1=2": f"{EXISTS} field.csv",
    "predict calibration --out rig.yaml/new.csv --grid x_mm=0 --current coil1=2": "output must be writable; "
    "rig.yaml/new.csv is not: Not a directory",
    f"{PREDICT} --grid x=1": f"{GRID} 'x=1'",
    f"{PREDICT} --grid x_deg=1": f"{GRID} 'x_deg=1'",
    f"{PREDICT} --grid u_mm=1": f"{GRID} 'u_mm=1'",
    f"{PREDICT} --grid x_mm=1:2": f"{GRID} 'x_mm=1:2'",
    f"{PREDICT} --grid x_mm=1:2:0": f"{GRID} 'x_mm=1:2:0'",
    f"{PREDICT} --grid x_mm=1:2:2.5": f"{GRID} 'x_mm=1:2:2.5'",
    f"{PREDICT} --grid x_mm=nan": f"{GRID} 'x_mm=nan'",
    f"{PREDICT} --grid x_mm=1 --grid x_cm=2": "--grid must name an axis once; received x_mm=1, x_cm=2",
    f"{PREDICT} --grid x_mm=0 --current coil2=1": "currents must name coils of the rig (coil1); received 'coil2'; the closest is coil1",
    f"{PREDICT} --grid x_mm=0 --current coil1=1": "--current must name coil1 once; received it again in 'coil1=1'",
    f"{PREDICT} --grid x_mm=0 --level 90": "level must lie between 0 and 1; received 90.0",
    f"{PREDICT} --grid x_mm=0 --level nan": "--level must be a number between -1e+12 and 1e+12; received nan",
    f"{PREDICT} --grid x_mm=0 --motion arm1=0,0,1": "--motion must look like NAME=1.0,1.0,1.0,1.0,1.0,1.0; received 'arm1=0,0,1'",
    f"{PREDICT} --grid x_mm=0 --motion arm2=0,0,0,0,0,0": "motion must name movers of the rig (arm1); received 'arm2'; the closest is arm1",
    "diagnose session.zarr --out calibration": f"{EXISTS} calibration",
    "diagnose session.zarr --out rig.yaml": f"{EXISTS} rig.yaml",
    "diagnose no.zarr --out new": f"{NO_SESSION} no.zarr",
    "diagnose readings.csv --out new": f"{NO_SESSION} readings.csv",
    "diagnose calibration/chain.zarr --out new": "session must be of kind 'coilcal session'; received None (calibration/chain.zarr)",
    "diagnose session.zarr --validation no.zarr --out new": f"{NO_SESSION} no.zarr",
    "diagnose session.zarr --rig no.yaml --out new": "no.yaml must be readable as text: No such file or directory",
    "diagnose session.zarr --device xpu:7 --out new": "device must be one that torch can compute on here, such as cpu; received 'xpu:7'",
    "diagnose session.zarr --rig plan.yaml --out new": "coils must name at least one; received none (plan.yaml, line 1)",
    "report session.zarr": f"{NO_CALIBRATION} session.zarr",
    "report calibration --out rig.yaml": f"{EXISTS} rig.yaml",
    "report calibration --out rig.yaml/new.html": "output must be writable; rig.yaml/new.html is not: Not a directory",
}


@pytest.fixture(scope="module", autouse=True)
def bad_files(workspace: Path) -> None:
    """Files as a hurried user makes them."""
    header, *rows = (workspace / "readings.csv").read_text(encoding="utf-8").splitlines()
    columns = header.split(",")
    assert columns[-1] == "set"

    def written(
        name: str, change: Callable[[dict[str, str]], dict[str, str]], lines: list[str] = rows
    ) -> None:
        table = [change(dict(zip(columns, line.split(","), strict=True))) for line in lines]
        text = "\n".join([",".join(table[0]), *(",".join(row.values()) for row in table)])
        (workspace / name).write_text(text + "\n", encoding="utf-8")

    def without_set(row: dict[str, str]) -> dict[str, str]:
        return {name: cell for name, cell in row.items() if name != "set"}

    written("whole.csv", without_set)
    written(
        "mm.csv",
        lambda row: row | {f"arm1_{axis}_m": repr(1e3 * float(row[f"arm1_{axis}_m"])) for axis in "xyz"},
    )
    written("off.csv", lambda row: row | {"coil1_current_A": "0"})
    times = iter(range(20))
    written("still.csv", lambda row: without_set(row) | {"t_s": str(next(times))}, rows[:1] * 20)
    written("one.csv", without_set, rows[:1])
    (workspace / "words.json").write_text('{"coil1.radius_m": "51 mm"}', encoding="utf-8")
    rig = (workspace / "rig.yaml").read_text(encoding="utf-8")
    (workspace / "other.yaml").write_text(rig.replace("arm1", "arm2"), encoding="utf-8")


@pytest.mark.parametrize(("command", "message"), REFUSALS.items())
def test_a_mistake_gives_one_sentence_and_exit_code_2_and_leaves_nothing(in_workspace, command, message):
    assert refused(run(*command.split())) == message.format(here=in_workspace)


@pytest.mark.parametrize(("command", "writer"), [("calibrate", only_writer), ("diagnose", staged)])
def test_two_programs_do_not_write_one_output(in_workspace, command, writer):
    with writer(in_workspace / "out"):
        words = refused(run(command, "session.zarr", "--out", "out"))
    assert words == "output must be written by one program at a time; another writes out"


@pytest.mark.parametrize(
    "command",
    [
        "simulate",
        "simulate --rig rig.yaml --plan plan.yaml --out new.zarr --seed -1",
        "simulate --rig rig.yaml --plan plan.yaml --out new.zarr --seed 4294967296",
        "calibrate session.zarr --out new --counts whole",
        "import --rig rig.yaml --out new.zarr",
        "diagnose",
        "diagnose session.zarr",
        "diagnose session.zarr --out new --seed -1",
        "unknown",
    ],
)
@pytest.mark.usefixtures("in_workspace")
def test_a_wrong_call_gets_the_usage_of_the_command(command):
    result = run(*command.split())
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith("Usage: ")
