"""Judges new sessions against the current calibration and prints what changed; edit the three paths, or call it from a scheduler.

`coilcal recalibrate` does the same from the command line, with alerts and `--every 6h`.
"""

from __future__ import annotations

from pathlib import Path

from estimator import Registry, load_rig, recalibrate

RIG = Path("rig.yaml")
INBOX = Path("inbox")  # sessions arrive here as *.zarr
REGISTRY = Path("registry")


def main() -> None:
    for entry in recalibrate(load_rig(RIG), INBOX, REGISTRY, seed=1):
        print(f"{entry.taken}  {Path(entry.session).name}: {entry.conclusion}, {entry.reason}")
        if entry.since is not None:
            print(f"  since {entry.since}")
    registry = Registry(REGISTRY)
    if registry.current is None:
        print("there is no calibration yet")
        return
    history = registry.history()
    history = history.sel(parameter=~history.is_derived)
    print(history["median"].to_pandas().T.to_string())
    print(f"version {registry.current} is in use; its posterior: {registry.tree()['posterior'].sizes}")


if __name__ == "__main__":
    main()
