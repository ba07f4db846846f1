"""Every study of the paper in one run: tables with our numbers beside those of the paper that are at hand, and figures.

`make paper` runs it, in some minutes on two cores; `docs/paper.md` discusses the results. The studies `sensitivity.py`, `solvers.py`,
`simulation_study.py`, `experiment_twin.py` and `errata.py` in this folder also run one by one.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import torch

from scripts.paper import errata, experiment_twin, sensitivity, simulation_study, solvers

ROOT = Path(__file__).resolve().parents[2]
INTRODUCTION = """\
A dash in a column of the paper stands for a number that was not at hand while this was written; none is made up. Where the paper is
silent, the choice is ours: 3 A, and a workspace of 100 x 100 x 50 mm whose middle lies 40 mm in front of the coil's face.
"""


def studies(out: Path) -> dict[str, Callable[[], str]]:
    """Title and function of each study, in the order of the paper."""
    return {
        "Sensitivity (section 4.2)": lambda: sensitivity.study(out),
        "Solvers (section 4.3)": solvers.study,
        "Simulation": lambda: simulation_study.study(out),
        "Twin of the experiment": lambda: experiment_twin.study(out),
        "Errata": errata.study,
    }


def run(title: str, out: Path) -> str:
    """One study, with its time."""
    torch.set_num_threads(1)
    begin = time.perf_counter()
    text = studies(out)[title]()
    return f"## {title}\n\n{text}\n({time.perf_counter() - begin:.0f} s)\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "out/paper")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    parts = [INTRODUCTION]
    print(INTRODUCTION)
    with ProcessPoolExecutor(options.processes, mp_context=get_context("spawn")) as pool:
        for done in [pool.submit(run, title, options.out) for title in studies(options.out)]:
            parts.append(done.result())
            print(parts[-1], flush=True)
    (options.out / "tables.md").write_text("\n".join(parts), encoding="utf-8")
    print(f"tables and figures: {options.out}")


if __name__ == "__main__":
    main()
