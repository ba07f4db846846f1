"""Calls on workers: one that dies is replaced, a call that kills them all is given up, a scheduler that comes back is used again."""

from __future__ import annotations

import subprocess
import threading

import pytest
from distributed import LocalCluster

from estimator.batching import engine
from estimator.batching.engine import Cluster, cluster, outcome, run_here
from estimator.errors import InvalidInput
from tests.estimator.batching.calls import deadly, deadly_once, double, refuse, slowly, variable
from tests.estimator.batching.schedulers import free_address, started, stop


def results(where: Cluster, calls) -> dict[object, object]:
    received: dict[object, object] = {}
    where.run(calls, received.__setitem__)
    return received


def test_each_call_is_heard_of_once_and_a_fault_in_one_leaves_the_others():
    with (
        LocalCluster(n_workers=1, processes=False, dashboard_address="127.0.0.1:0") as local,
        cluster(None, local.scheduler_address) as where,
    ):
        received = results(where, {"a": (double, (2,)), "b": (refuse, (3,)), "c": (double, (4,))})
    assert received["a"] == 4
    assert received["c"] == 8
    assert str(received["b"]) == "ValueError: 3 is refused"


def test_this_process_makes_calls_as_workers_do():
    received: dict[object, object] = {}
    run_here({"a": (double, (2,)), "b": (refuse, (3,)), "c": (double, (4,))}, received.__setitem__)
    assert (received["a"], received["c"]) == (4, 8)
    assert str(received["b"]) == "ValueError: 3 is refused"


def test_a_fault_in_whoever_hears_of_results_is_no_lost_scheduler():
    def closed(*_: object) -> None:
        raise BrokenPipeError(32, "Broken pipe")

    with (
        LocalCluster(n_workers=1, processes=False, dashboard_address="127.0.0.1:0") as local,
        cluster(None, local.scheduler_address) as where,
        pytest.raises(BrokenPipeError),
    ):
        where.run({"a": (double, (2,))}, closed)


def test_the_client_that_is_left_at_the_end_is_closed_also_where_it_is_another_one():
    with cluster(1, None) as where:
        where._reconnect()
        assert results(where, {"a": (double, (2,))}) == {"a": 4}
        last = where._client
    assert last.status == "closed"


def test_workers_keep_their_memory_and_have_one_thread_each():
    with cluster(1, None) as where:
        names = ("MALLOC_TRIM_THRESHOLD_", "OMP_NUM_THREADS")
        assert results(where, {name: (variable, (name,)) for name in names}) == dict(
            zip(names, (None, "1"), strict=True)
        )


def test_a_killed_worker_is_survived_and_a_call_that_kills_every_worker_is_given_up(tmp_path):
    with cluster(2, None) as where:
        calls = {i: (deadly_once, (str(tmp_path / "flag"), i)) for i in range(6)}
        assert results(where, calls) == {i: 2 * i for i in range(6)}
        assert (tmp_path / "flag").exists()
        assert str(results(where, {"x": (deadly, ())})["x"]) == "4 workers died on it"


def test_a_worker_that_dask_gives_up_is_replaced(tmp_path, monkeypatch):
    """Its process takes longer to start again than Dask waits, and then its calls waited for ever."""
    monkeypatch.setattr(engine, "LOST_S", 0)
    monkeypatch.setattr(engine, "REPLACE_EVERY_MS", 100)
    has_ended = threading.Event()
    with cluster(1, None) as where:
        future = where.start((deadly_once, (str(tmp_path / "flag"), 3)), has_ended.set)
        assert has_ended.wait(30)
        assert outcome(future) == "done"


def test_a_scheduler_that_is_lost_and_comes_back_costs_no_result():
    address = free_address()
    first = started(address)
    try:
        with cluster(None, address) as where:
            heard: dict[object, object] = {}
            replaced: list[subprocess.Popen[bytes]] = []

            def hear(name: object, result: object) -> None:
                heard[name] = result
                if not replaced:
                    stop(first)
                    replaced.extend(started(address))

            try:
                where.run({i: (slowly, (i,)) for i in range(3)}, hear)
            finally:
                stop(replaced)
        assert heard == {0: 0, 1: 2, 2: 4}
    finally:
        stop(first)


def test_a_scheduler_that_does_not_answer_is_one_sentence(monkeypatch):
    monkeypatch.setattr("estimator.batching.engine.PATIENCE_S", 1)
    with (
        pytest.raises(InvalidInput, match="scheduler must answer within 1 s; tcp://127.0.0.1:1 did not"),
        cluster(None, "tcp://127.0.0.1:1"),
    ):
        pass
    with pytest.raises(InvalidInput, match="workers must not be given"), cluster(2, "tcp://127.0.0.1:1"):
        pass
