"""Every study of the paper in one run: its tables with our numbers beside the printed ones, and figures.

`make paper` runs it, in about twenty minutes on two cores; `docs/paper.md` discusses the results. Each study's tables are kept in
`parts/` with the commit that made them, so an interrupted run continues; a changed tree runs all again but
the twins of `residual_causes.jsonl`, which are made again where that file is removed. The studies in this folder also
run one by one.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import torch

from estimator.code_version import code_version
from scripts.paper import (
    errata,
    errata_of_tables,
    experiment_twin,
    residual_ranking,
    sensitivity,
    simulation_study,
    solvers,
    whole_counts,
)

ROOT = Path(__file__).resolve().parents[2]
INTRODUCTION = """\
The paper's numbers are those of its Tables 1 to 10, digit for digit (`scripts/paper/printed.py`). Where it is silent, the choice is ours:
3 A, and a workspace of 100 x 100 x 50 mm whose middle lies 40 mm in front of the coil's face, unless a table says otherwise.
"""


def studies(out: Path) -> dict[str, Callable[[], str]]:
    """Title and function of each study, the longest first."""
    return {
        "Causes of the residual (Tables 8 to 10)": lambda: residual_ranking.study(out),
        "Twin of the experiment (Tables 8 to 10, Figs 12, 13)": lambda: experiment_twin.study(out),
        "Solvers (section 4.3, Table 2)": solvers.study,
        "Simulation (Tables 3 to 7, Figs 9, 10)": lambda: simulation_study.study(out),
        "Whole counts (Tables 2, 3)": whole_counts.study,
        "Sensitivity (section 4.2, Table 1, Fig 8)": lambda: sensitivity.study(out),
        "Errata of formulas": errata.study,
        "Errata of tables": errata_of_tables.study,
    }


def run(title: str, out: Path) -> str:
    """One study with its time, or what the same code has printed of it before."""
    torch.set_num_threads(1)
    part = out / "parts" / f"{title.partition(' (')[0].replace(' ', '_').lower()}.md"
    version = code_version() or "unknown"
    made_by, is_known = f"<!-- {version} -->\n", version != "unknown" and not version.endswith("-dirty")
    if is_known and part.exists() and (text := part.read_text(encoding="utf-8")).startswith(made_by):
        return text.removeprefix(made_by)
    begin = time.perf_counter()
    text = f"## {title}\n\n{studies(out)[title]()}\n({time.perf_counter() - begin:.0f} s)\n"
    part.parent.mkdir(parents=True, exist_ok=True)
    part.write_text(made_by + text, encoding="utf-8")
    return text


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
