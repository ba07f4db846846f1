"""The studies of the paper: printed numbers, the programme of the paper, its solvers, and how causes are ranked."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from scripts.paper import (
    errata_of_tables,
    printed,
    programme,
    residual_causes,
    residual_ranking,
    solvers,
    whole_counts,
)
from scripts.paper.residual_causes import CAUSES, Mistake, Twin
from tests.independent.readings import coil_field_T


def test_a_printed_number_stands_for_all_that_round_to_it():
    assert printed.interval("0.0027") == (0.00265, 0.00275)
    low, high = printed.reduction_percent("1.1000e-03", "4.2622e-04")
    assert (round(low, 2), round(high, 2)) == (61.25, 61.25)


def test_two_entries_of_the_tables_are_misprints_and_no_others():
    said = errata_of_tables.scales().splitlines()
    flagged = [line for line in said if "the other three" in line]
    assert len(flagged) == 2
    assert "rms before" in flagged[0]
    assert "largest after" in flagged[1]
    assert "0.00696 to 0.00705" in errata_of_tables.repaired()


def test_the_pose_of_table_8_is_in_the_copper_unless_its_rotation_goes_the_other_way():
    said = errata_of_tables.sensor_of_table_8()
    assert said.count("inside the copper") == 2
    assert "39.5 mm in front of the face" in said
    places = programme.sensor_in_coil_m(np.array(printed.CALIBRATED_POSE), np.zeros((1, 3)))
    np.testing.assert_allclose(places, [[31.78e-3, 15.27e-3, 39.51e-3]], atol=1e-5)


def test_the_programme_adds_the_loops_that_magpylib_adds():
    places_m = programme.box_m(3, 0.015)
    ours = programme.field_per_ampere(places_m, (51.2, 0.49, 47.6, 24.8), counts=round)
    reference = coil_field_T(places_m, 0.0512, 0.49e-3, 48, 25, 1.0)
    np.testing.assert_allclose(ours, reference, atol=2e-5 * np.abs(reference).max())


def test_rounded_counts_hold_the_paper_s_search_and_real_ones_do_not():
    real, rounded = (whole_counts.cost_mT(0.015, counts) for counts in (float, round))
    np.testing.assert_allclose(whole_counts.nelder_mead(real), printed.SIMULATED_TRUTH, rtol=1e-4)
    stuck = whole_counts.nelder_mead(rounded)
    assert round(stuck[3]) == printed.SIMULATED_FOUND[3]
    assert stuck[1] < printed.SIMULATED_START[1]
    assert 0.6 < 1.0 - rounded(stuck) / rounded(whole_counts.START) < 0.99


def test_quadratic_programming_never_moves_a_rounded_count():
    found = whole_counts.sqp(whole_counts.cost_mT(0.025, round))
    np.testing.assert_allclose(found[2:], printed.SIMULATED_START[2:], atol=0.5)
    assert abs(found[0] - printed.SIMULATED_START[0]) > 1.0


@pytest.mark.whole
def test_the_genetic_algorithm_begins_at_the_start_keeps_the_best_and_stays_in_the_box(monkeypatch):
    monkeypatch.setattr(solvers, "GENERATIONS", 4)
    problem = solvers.Problem(is_whole=True)
    truth = np.array(list(solvers.TRUTH.values()))
    ends = solvers.genetic(problem, np.stack((truth, problem.starts(1)[0])))
    np.testing.assert_allclose(ends.values[0], truth, rtol=1e-12)
    assert ends.evaluations.tolist() == [4 * solvers.POPULATION] * 2
    assert (problem.lower <= ends.values).all()
    assert (ends.values <= problem.upper).all()


def test_an_iron_table_turns_the_field_on_its_surface_upright_and_doubles_it():
    def reading_T(wrong: Mistake) -> np.ndarray:
        return residual_causes.nature_T(residual_causes.START, np.zeros((1, 3)), wrong, 1.0)[0]

    alone_T, on_it_T = reading_T(Mistake()), reading_T(Mistake(mirror=(1.0, 0.0)))
    np.testing.assert_allclose(on_it_T, alone_T * [0.0, 0.0, 2.0], atol=1e-12)
    above_T = reading_T(Mistake(mirror=(1.0, 0.03)))
    assert 0.0 < np.linalg.norm(above_T - alone_T) < np.linalg.norm(on_it_T - alone_T)


@pytest.mark.parametrize("cause", sorted(CAUSES))
def test_every_twin_has_its_sensor_in_front_of_the_coil(cause):
    for seed in range(3):
        wrong = CAUSES[cause](np.random.default_rng([seed, 0]))
        truth, middle_m, current_A = residual_causes.drawn(seed, wrong)
        moved_m = (middle_m + programme.box_m(5, -0.025)) @ np.array(wrong.displacement).T
        assert programme.sensor_in_coil_m(truth[4:], moved_m)[:, 2].min() > residual_causes.NEAREST_M
        assert 0.3 <= current_A <= 5.0


def test_twins_that_a_file_holds_are_not_drawn_again(tmp_path):
    rows = [_twin(cause, seed) for cause in CAUSES for seed in range(2)]
    path = tmp_path / "residual_causes.jsonl"
    path.write_text("".join(json.dumps(asdict(row)) + "\n" for row in rows))
    again = residual_causes.twins(path, n=2)
    assert {(twin.cause, twin.seed) for twin in again} == {(row.cause, row.seed) for row in rows}


def test_the_cause_that_gives_the_printed_numbers_comes_first():
    rng = np.random.default_rng(1)
    rows = []
    for cause in CAUSES:
        after_T = 2.7e-3 if cause == "iron table" else 0.27e-3
        for seed in range(8):
            scatter = np.exp(0.05 * rng.normal(size=16))
            row = _twin(cause, seed)
            rms_T, max_T = (
                np.array([4.3e-3, after_T]) * scatter[:2],
                np.array([9.2e-3, 7.0e-3]) * scatter[2:4],
            )
            numbers = np.array(row.numbers) * scatter[4:14]
            rows.append(replace(row, rms_T=rms_T.tolist(), max_T=max_T.tolist(), numbers=numbers.tolist()))
    first = residual_ranking.ranking(rows).splitlines()[4]
    assert first.startswith("| iron table ")
    assert "no, largest field" in first


def _twin(cause: str, seed: int) -> Twin:
    numbers = [*printed.CALIBRATED, *printed.CALIBRATED_POSE]
    return Twin(cause, seed, list(numbers), 1.0, [4.3e-3, 2.7e-3], [9.2e-3, 7.0e-3], 0.04, 0.104, 1000)
