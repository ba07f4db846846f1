"""How much each rule with a number matters: halve and double it, and compare what comes out; `make policy` runs it.

Cases are hidden causes of the generator, designs of further readings, and sessions that are judged against a calibration. Each runs
once as the policies stand. Where a second run first reads a rule, the process forks for each other value of it: until then nothing depends
on it, so the fork goes on as a run with that value from the beginning would, and rules that a case never reads cost nothing. Every run is
appended to a file as it ends, so an interrupted study continues. Afterwards a table says, per rule and value, in how many cases
the verdict, the names or numbers change.

Rules of a diagnosis are tried on the first two kinds of case, those of a recalibration on the last.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

from estimator import (
    Calibration,
    SamplerSettings,
    Session,
    calibrate,
    diagnose,
    draw_truth,
    load_plan,
    load_rig,
    simulate,
)
from estimator.diagnosis import policy as diagnosis_policy
from estimator.diagnosis.next_readings.design import design
from estimator.diagnosis.result import Diagnosis
from estimator.recalibration import policy as recalibration_policy
from estimator.recalibration.judgement import judge
from estimator.store.importers.readings_csv import read_readings_csv
from scripts.studies.hidden_cases import one_thread
from scripts.studies.recalibrate_years import CONFIGS, PLAN
from tests.hidden.study import KINDS, draw_case

Row = dict[str, Any]
Value = float | int | tuple[float, ...]
FACTORS = (0.5, 2.0)
SPLIT = ("background_field", "axis_gain[hall]")  # what a design is to tell apart
HIDDEN = {"unchanged": {}, "drifted": {"sensor_offset.x_T": 60e-6}, "moved": {"background_field.x_T": 8e-6}}
SETTINGS = SamplerSettings(n_walkers=32, target_ess=200.0, max_steps=1500)
# Change of a log evidence, and in standard deviations: rounding of optimisers that stop elsewhere
VISIBLE_CHANGE = 1e-3


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    kinds = (*KINDS, "design", *HIDDEN)
    parser.add_argument("--kinds", default=",".join(kinds))
    parser.add_argument("--cases", type=int, default=3, help="of each kind")
    parser.add_argument("--first-seed", type=int, default=20_000)
    parser.add_argument("--rules", default="", help="only these, joined by commas")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("out/policy.jsonl"))
    parser.add_argument("--table", action="store_true", help="of the runs so far; run nothing")
    options = parser.parse_args()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    if not options.table:
        seeds = range(options.first_seed, options.first_seed + options.cases)
        cases = [
            (kind, seed, options.out, tuple(filter(None, options.rules.split(","))))
            for seed in seeds
            for kind in options.kinds.split(",")
        ]
        if set(HIDDEN) & set(options.kinds.split(",")):
            current_calibration(options.out.parent)  # once, before several workers want it
        with multiprocessing.get_context("spawn").Pool(options.workers, initializer=one_thread) as pool:
            for words in pool.imap_unordered(run_case, cases, chunksize=1):
                print(words, file=sys.stderr, flush=True)
    show(read(options.out))


def other_values(name: str, value: Value) -> list[Value]:
    """Half and twice a rule: of a prior probability its logarithm less and plus log 2, of a share near one the rest of it.

    Examples:
        >>> other_values("MOST_CAUSES", 4), other_values("VALIDATION_SHARE", 0.95), other_values("DEGREES", (1, 2, 3))
        ([2, 8], [0.975, 0.9], [(1, 2), (2, 4, 6)])
    """
    if isinstance(value, tuple) and isinstance(value[0], tuple):  # factors and their probabilities
        return [tuple((factor * first, *rest) for first, *rest in value) for factor in FACTORS]
    if isinstance(value, tuple):
        is_whole = all(isinstance(part, int) for part in value)
        parts = [[max(1, math.ceil(f * v)) if is_whole else f * v for v in value] for f in FACTORS]
        return [tuple(dict.fromkeys(part)) for part in parts]
    if isinstance(value, int):
        return [max(1, math.ceil(factor * value)) for factor in FACTORS]
    if name.startswith("LOG_PRIOR"):
        return [value + math.log(factor) for factor in FACTORS]
    if 0.5 < value < 1.0:
        return [1.0 - factor * (1.0 - value) for factor in FACTORS]
    return [factor * value for factor in FACTORS]


class Branches:
    """Watches a policy and forks a run where it first reads a rule, once for each other value."""

    def __init__(self, case: str, policy: ModuleType, out: Path, rules: tuple[str, ...]) -> None:
        self.case, self.policy, self.out = case, policy, out
        self.done = {(row["rule"], row["which"]) for row in read(out) if row["case"] == case}
        self.seen = {name for name in vars(policy) if name.isupper() and rules and name not in rules}
        self.rule, self.which = "", -1  # of this process; none where nothing was changed
        branches = self

        class Watched(ModuleType):
            def __getattribute__(self, name: str) -> Any:
                if name.isupper() and not branches.rule and name not in branches.seen:
                    branches.fork_at(name)
                return super().__getattribute__(name)

        policy.__class__ = Watched

    def fork_at(self, name: str) -> None:
        """A child goes on with each other value; this process waits for it, and goes on with the value as it stands."""
        self.seen.add(name)
        for which, value in enumerate(other_values(name, vars(self.policy)[name])):
            if (name, which) in self.done:
                continue
            child = os.fork()
            if child == 0:
                self.rule, self.which = name, which
                setattr(self.policy, name, value)
                return
            os.waitpid(child, 0)

    def run(self, outcome: Callable[[], Row]) -> None:
        """Append what comes out as the policy stands, and in every child."""
        if (
            self.rule,
            self.which,
        ) not in self.done:  # first, so that a study that is cut short has something to compare with
            child = os.fork()
            if child == 0:
                self.seen = {name for name in vars(self.policy) if name.isupper()}
                self._append(outcome)
                os._exit(0)
            os.waitpid(child, 0)
            self.done.add((self.rule, self.which))
        self._append(outcome)
        if self.rule:
            sys.stdout.flush()
            os._exit(0)

    def _append(self, outcome: Callable[[], Row]) -> None:
        try:
            result = outcome()
        except Exception as error:  # a value that a diagnosis cannot do with is a result of the study
            traceback.print_exc()
            result = {"error": f"{type(error).__name__}: {error}"}
        if (self.rule, self.which) in self.done:
            return
        row = {"case": self.case, "rule": self.rule, "which": self.which, **result}
        with self.out.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")


def run_case(case: tuple[str, int, Path, tuple[str, ...]]) -> str:
    kind, seed, out, rules = case
    policy = recalibration_policy if kind in HIDDEN else diagnosis_policy
    branches = Branches(f"{kind} {seed}", policy, out, rules)
    if kind in HIDDEN:
        branches.run(lambda: judged(kind, seed, current_calibration(out.parent)))
    elif kind == "design":
        branches.run(lambda: designed(hidden_session("clean", seed)))
    else:
        branches.run(lambda: diagnosed(diagnose(hidden_session(kind, seed), seed=seed)))
    return f"{kind} {seed}: {len(branches.seen)} rules"


def hidden_session(kind: str, seed: int) -> Session:
    with tempfile.TemporaryDirectory() as folder:
        draw_case(kind, seed).write(Path(folder))
        rig = load_rig(Path(folder) / "rig.yaml")
        return read_readings_csv(Path(folder) / "readings.csv", rig)


def diagnosed(diagnosis: Diagnosis) -> Row:
    """What a diagnosis said: verdict, sets of names, log evidences, standard deviations, and all else."""
    record = diagnosis.to_json()
    evidence = {
        "left": record["unexplained"]["log_bayes_factor"],
        "final": diagnosis.fits.extended.log_evidence - diagnosis.findings.answer.plain.log_evidence,
    }
    for rival in record["steps"][0]["considered"]:
        evidence[rival["name"]] = rival["log_bayes_factor"]
    parameters = {**record["rig_parameters"]}
    for cause in record["causes"]:
        parameters |= {f"{cause['name']}.{key}": value for key, value in cause["parameters"].items()}
    rest = {
        key: record.get(key)
        for key in (
            "stand_ins",
            "indistinguishable",
            "next_measurement",
            "smallest_visible",
            "signatures",
            "gain",
        )
    }
    rest["alternatives"] = [cause["alternatives"] for cause in record["causes"]]
    rest["sentences"] = [diagnosis.fits.before.sentences(), diagnosis.fits.after.sentences()]
    return {
        "verdict": record["verdict"],
        "names": [[cause["name"], *(o["name"] for o in cause["alternatives"])] for cause in record["causes"]],
        "evidence": evidence,
        "sd": {name: value["sd"] for name, value in parameters.items()},
        "rest": rest,
    }


def designed(session: Session) -> Row:
    chosen = design(session, split=SPLIT, n_readings=5)
    return {
        "verdict": "designed",
        "names": [],
        "evidence": {
            **{one.action.words: one.expected_log_evidence for one in chosen.actions},
            "so far": chosen.so_far,
        },
        "sd": {},
        "rest": {"plan": chosen.plan, "reached": list(chosen.reached)},
    }


def current_calibration(folder: Path) -> Calibration:
    """What sessions are judged against; made once."""
    path = folder / "policy_calibration"
    if path.exists():
        return Calibration.load(path)
    calibration = calibrate(weekly_session({}, 1), settings=SETTINGS, seed=1)
    calibration.save(path)
    return calibration


def weekly_session(hidden: dict[str, float], seed: int) -> Session:
    rig = load_rig(CONFIGS / "paper_simulation.yaml")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plan.yaml"
        path.write_text(PLAN, encoding="utf-8")
        plan = load_plan(path, rig)
    return Session(rig, simulate(rig, plan, draw_truth(rig, 20), seed, hidden), "simulated")


def judged(kind: str, seed: int, current: Calibration) -> Row:
    session = weekly_session(HIDDEN[kind], seed)
    found = judge(session, session.rig, current, may_replace=False, seed=seed)
    evidence = {name: math.log(value) for name, value in found.checks["p_values"].items()}
    return {
        "verdict": str(found.conclusion),
        "names": [[cause["name"], *(o["name"] for o in cause["alternatives"])] for cause in found.causes],
        "evidence": {"p": math.log(found.checks["p_value"]), **evidence},
        "sd": {name: sd for name, (_, sd) in found.estimate.items()},
        "rest": {"striking_cause": found.checks["striking_cause"]},
    }


def read(path: Path) -> list[Row]:
    return (
        [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []
    )


def changes(before: Row, after: Row) -> list[str]:
    """What differs between two runs of a case, the weightiest first; empty where nothing does."""
    if "error" in after:
        return ["fails"]
    words = []
    if before["verdict"] != after["verdict"]:
        words.append("verdict")
    if [sorted(names) for names in before["names"]] != [sorted(names) for names in after["names"]]:
        words.append("names")
    both = before["evidence"].keys() & after["evidence"].keys()
    evidence = max((abs(before["evidence"][n] - after["evidence"][n]) for n in both), default=0.0)
    if evidence > VISIBLE_CHANGE:
        words.append(f"evidence {evidence:.2g}")
    shared = before["sd"].keys() & after["sd"].keys()
    sd = max(
        (abs(math.log(after["sd"][n] / before["sd"][n])) for n in shared if before["sd"][n]), default=0.0
    )
    if sd > VISIBLE_CHANGE:
        words.append(f"sd {100.0 * math.expm1(sd):.2g} %")
    words += [f"{key}" for key in before["rest"] if not is_same(before["rest"][key], after["rest"].get(key))]
    return words


def is_same(one: Any, other: Any) -> bool:
    """Whether two pieces of JSON are alike but for rounding."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(is_same(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(is_same, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=VISIBLE_CHANGE, abs_tol=1e-12)
    return bool(one == other)


def show(rows: list[Row]) -> None:
    base = {row["case"]: row for row in rows if not row["rule"]}
    listed = ", ".join(f"{case} ({row.get('verdict', 'failed')})" for case, row in base.items())
    print(f"{len(base)} cases: {listed}")
    for title, policy in (("diagnosis", diagnosis_policy), ("recalibration", recalibration_policy)):
        print(f"\n| {title} | value | cases | verdict | names | what changes |\n|---|---|---|---|---|---|")
        for name in constants(policy):
            value = vars(policy)[name]
            for which, other in enumerate(other_values(name, value)):
                runs = [
                    changes(base[row["case"]], row)
                    for row in rows
                    if (row["rule"], row["which"]) == (name, which) and "verdict" in base.get(row["case"], {})
                ]
                print(f"| `{name}` {shown(value)} | {shown(other)} | {' | '.join(columns(runs))} |")


def columns(runs: list[list[str]]) -> Iterator[str]:
    """Of one rule at one value: cases, changed verdicts, changed names, and the largest change of everything else."""
    yield str(len(runs)) if runs else "none"
    for word in ("verdict", "names"):
        n = sum(word in run for run in runs)
        yield str(n) if n else "-"
    other = Largest()
    for run in runs:
        other.add(word for word in run if word not in ("verdict", "names"))
    yield str(other) if runs else ""


class Largest:
    """Words of changes, those with a number once with their largest."""

    def __init__(self) -> None:
        self.words: dict[str, float] = {}

    def add(self, words: Iterable[str]) -> None:
        """Those of one run."""
        for word in words:
            key, _, number = word.partition(" ")
            size = float(number.removesuffix(" %")) if number else 0.0
            self.words[key] = max(self.words.get(key, 0.0), size)

    def __str__(self) -> str:
        units = {"evidence": "", "sd": " %"}
        parts = (
            f"{k} {v:.2g}{units[k]}" if k in units else k.replace("_", " ") for k, v in self.words.items()
        )
        return ", ".join(parts) or "nothing"


def constants(policy: ModuleType) -> list[str]:
    """Names of the rules, in their order."""
    return [name for name in vars(policy) if name.isupper()]


def shown(value: Value) -> str:
    if isinstance(value, tuple):
        return "(" + ", ".join(shown(part) for part in value) + ")"
    return f"{value:.4g}"


if __name__ == "__main__":
    main()
