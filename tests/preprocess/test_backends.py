"""Workers of this machine and of a real cluster, some of which die: the same bytes come out."""

from __future__ import annotations

import os
import signal
import threading
import time

import pytest

from grabnet.data.frames import shard_names
from grabnet.errors import UserError
from grabnet.preprocess.backends import by_dask, by_joblib
from tests.preprocess.dying import Dying
from tests.preprocess.tiny_grab import data_set, make

NAMES = ["a", "die once", "b", "die always", "c", "d", "e", "f"]


def assert_all_done_but_the_deadly(outcomes, folder):
    by_name = {outcome.name: outcome.failure for outcome in outcomes}
    assert sorted(by_name) == sorted(NAMES)
    assert by_name.pop("die always").startswith("The process that worked on it died")
    assert set(by_name.values()) == {None}
    return len(list(folder.glob("die always.*")))


def test_joblib_survives_its_workers(tmp_path):
    deaths = assert_all_done_but_the_deadly(by_joblib(Dying(tmp_path), NAMES, 2, max_deaths=2), tmp_path)
    assert 2 <= deaths <= 4


def test_two_processes_write_what_one_writes(grab, made, tmp_path, cache_dir):
    assert make(grab, tmp_path, cache_dir, "workers=2") == {}
    assert data_set(tmp_path) == data_set(made)


def test_a_cluster_that_loses_a_worker_writes_what_one_process_writes(grab, made, tmp_path, cache_dir):
    import dask
    from distributed import LocalCluster

    output = tmp_path / "data"
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),  # one death is enough to be blamed
        LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50, local_directory=str(tmp_path)
        ) as cluster,
    ):

        def kill_one_half_way():
            while len(shard_names(output / "frames")) < 2:
                time.sleep(0.002)
            os.kill(cluster.workers[0].pid, signal.SIGKILL)

        killer = threading.Thread(target=kill_one_half_way, daemon=True)
        killer.start()
        failures = make(grab, output, cache_dir, "backend=dask", f"dask_address={cluster.scheduler_address}")
        killer.join()
        assert failures == {}
        cluster.scheduler.allowed_failures = 1  # so that "die once" survives, whatever it was blamed for before
        deaths = assert_all_done_but_the_deadly(by_dask(Dying(tmp_path), NAMES, cluster.scheduler_address), tmp_path)
        assert 3 <= deaths <= 4  # twice among others, of which "die once" may have taken one upon itself; twice alone
    assert data_set(output) == data_set(made)


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch):
    monkeypatch.setattr("grabnet.preprocess.backends._PATIENCE", 0.5)
    with pytest.raises(UserError, match=r"No dask scheduler answers at dask_address=tcp://127\.0\.0\.1:1 "):
        next(by_dask(print, ["a"], "tcp://127.0.0.1:1"))


def _slow(name):
    time.sleep(0.2)
    return name


def test_a_scheduler_that_is_lost_is_named(tmp_path):
    import dask
    from distributed import LocalCluster

    with (
        dask.config.set({"distributed.comm.timeouts.connect": "1s"}),
        LocalCluster(
            n_workers=1, processes=False, dashboard_address=None, silence_logs=50, local_directory=str(tmp_path)
        ) as cluster,
    ):
        outcomes = by_dask(_slow, [*"abcdefgh"], cluster.scheduler_address)
        next(outcomes)
        cluster.sync(cluster.scheduler.close)
        with pytest.raises(UserError, match=r"The dask scheduler at dask_address=\S+ was lost"):
            list(outcomes)
