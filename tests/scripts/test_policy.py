"""The study of the policies: what half and twice a rule are, and a run that forks where a rule is first read."""

from __future__ import annotations

import math
import types

import pytest

from scripts.studies.policy import Branches, changes, other_values, read


@pytest.mark.parametrize(
    ("name", "value", "others"),
    [
        ("MOST_LEADERS", 4, [2, 8]),
        ("MOST_CAUSES", 1, [1, 2]),
        ("SURELY_NEEDED", 15.0, [7.5, 30.0]),
        ("CREDIBLE_SHARE", 0.95, [0.975, 0.9]),
        ("VALIDATION_SHARE", 0.2, [0.1, 0.4]),
        ("SIGNATURE_DEGREES", (1, 2, 3), [(1, 2), (2, 4, 6)]),
        ("WIDTHS", ((0.5, 0.25), (1.0, 0.75)), [((0.25, 0.25), (0.5, 0.75)), ((1.0, 0.25), (2.0, 0.75))]),
        ("DECAY_STEPS", (0.75, 2.0), [(0.375, 1.0), (1.5, 4.0)]),
        ("LOG_PRIOR_CAUSE", math.log(0.3), [math.log(0.15), math.log(0.6)]),
    ],
)
def test_half_and_twice_a_rule(name, value, others):
    assert other_values(name, value) == (pytest.approx(others) if isinstance(value, float) else others)


def row(**changed: object) -> dict[str, object]:
    same = {
        "verdict": "named",
        "names": [["a", "b"]],
        "evidence": {"a": 3.0},
        "sd": {"x": 1.0},
        "rest": {"gain": 1.0},
    }
    return {**same, **changed}


def test_changes_are_told_from_rounding():
    assert changes(row(), row(evidence={"a": 3.0001}, names=[["b", "a"]], rest={"gain": 1.00001})) == []
    after = row(verdict="unexplained", names=[], evidence={"a": 5.0}, sd={"x": 1.1}, rest={"gain": 2.0})
    assert changes(row(), after) == ["verdict", "names", "evidence 2", "sd 10 %", "gain"]
    assert changes(row(), {"error": "ValueError"}) == ["fails"]


def test_a_run_forks_where_a_rule_is_first_read(tmp_path):
    policy = types.ModuleType("policy")
    policy.SIZE, policy.UNREAD = 4.0, 1.0  # type: ignore[attr-defined]
    out = tmp_path / "runs.jsonl"

    def run() -> None:
        Branches("case 1", policy, out, ()).run(lambda: {"size": policy.SIZE + policy.SIZE})

    run()
    found = [(row["rule"], row["which"], row["size"]) for row in read(out)]
    assert found == [("", -1, 8.0), ("SIZE", 0, 4.0), ("SIZE", 1, 16.0)]
    run()  # what was done is not done again
    assert len(read(out)) == 3
