"""The same work on several recordings at once."""
import logging
import os
import signal
from functools import partial

import pytest

from car_interface.common.errors import CarInterfaceError
from car_interface.tools.cli import jobs
from car_interface.tools.cli.main import main
from written_recordings import drive, write_ros1


def leaving_a_mark(folder, number):
    (folder / str(number)).touch()
    if number == 0:
        raise CarInterfaceError("0 is refused")


@pytest.mark.parametrize("count", [1, 2])
def test_work_in_processes_comes_back_in_order(count):
    assert list(jobs.for_each(str, range(7), count)) == list("0123456")


@pytest.mark.parametrize("count", [1, 2])
def test_error_ends_the_work(count, tmp_path):
    with pytest.raises(CarInterfaceError, match="0 is refused"):
        list(jobs.for_each(partial(leaving_a_mark, tmp_path), range(1000), count))
    assert len(list(tmp_path.iterdir())) < 500  # of 1000; on a busy machine more are done before it's noticed


def test_process_that_was_killed_is_told_and_by_which_recording():
    with pytest.raises(CarInterfaceError, match="was killed, maybe for want of memory: try again with --jobs 1"):
        list(jobs.for_each(os._exit, [9, 9], 2))


# --- a dask cluster ---

@pytest.fixture(scope="module")
def cluster():
    """Two workers on loopback, which start as forks of one process that has imported all once."""
    pytest.importorskip("dask").config.set({
        "distributed.scheduler.allowed-failures": 1, "distributed.worker.multiprocessing-method": "forkserver"})
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None,
                                  silence_logs=logging.CRITICAL) as made:
        yield made


def killing_its_worker_once(folder, number):
    if number == 3 and not (folder / "killed").exists():
        (folder / "killed").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number, os.getpid()


@pytest.mark.once
def test_worker_of_a_cluster_that_is_killed_loses_nothing(cluster, tmp_path):
    work = partial(killing_its_worker_once, tmp_path)
    found = list(jobs.for_each(work, range(12), 1, cluster.scheduler_address))
    assert [number for number, _ in found] == list(range(12)) and (tmp_path / "killed").exists()
    assert os.getpid() not in {process for _, process in found}


def killing_each_worker(number):
    if number == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


@pytest.mark.once
def test_what_kills_each_worker_is_told_and_all_else_is_done(cluster, monkeypatch):
    monkeypatch.setattr(cluster.scheduler, "allowed_failures", 0)  # a new worker takes a second
    found = list(jobs.try_each(killing_each_worker, range(8), "", 1, cluster.scheduler_address))
    (_, error) = found.pop(2)
    assert found == [(number, "") for number in (0, 1, 3, 4, 5, 6, 7)]
    assert error.startswith("2 ended each worker that read it, maybe for want of memory")


@pytest.mark.once
def test_error_on_a_worker_ends_the_work_here(cluster, tmp_path):
    with pytest.raises(CarInterfaceError, match="0 is refused"):
        list(jobs.for_each(partial(leaving_a_mark, tmp_path), range(9), 1, cluster.scheduler_address))


@pytest.mark.once
def test_worker_with_another_version_is_refused(cluster, monkeypatch):
    monkeypatch.setattr(jobs, "version", lambda: "0.0.1")
    with pytest.raises(CarInterfaceError, match=r"worker on \S+ has car_interface [\d.]+, here is 0\.0\.1: install"):
        list(jobs.for_each(str, range(1), 1, cluster.scheduler_address))


@pytest.mark.once
def test_table_and_pages_of_a_cluster_are_those_of_this_computer(cluster, tmp_path, capsys, monkeypatch):
    for number in range(2):
        write_ros1(tmp_path / f"{number}.bag", [one for one in drive(6.0 + number) if one.topic == "/odom"])
    (tmp_path / "none.bag").write_bytes(b"#ROSBAG V2.0\n")
    monkeypatch.chdir(tmp_path)
    made = {}
    for options in (["--jobs", "1"], ["--scheduler", cluster.scheduler_address]):
        assert main("drives", [".", "--fresh", *options]) == 0
        assert main("bag_report", ["0.bag", "1.bag", *options]) == 0
        made[options[0]] = [(tmp_path / name).read_bytes()
                            for name in ("drives.csv", "drives.html", "0.html", "1.html")]
        for name in ("0.html", "1.html"):  # drives links to them
            (tmp_path / name).unlink()
    assert made["--jobs"] == made["--scheduler"]
    assert "none.bag is cut off or damaged" in capsys.readouterr().err


@pytest.mark.once
def test_scheduler_that_does_not_answer_is_told(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(jobs, "SCHEDULER_TIMEOUT_S", 0.2)
    with pytest.raises(CarInterfaceError, match=r"tcp://127.*: no scheduler of a dask cluster answers there"):
        list(jobs.for_each(str, range(1), 1, "tcp://127.0.0.1:1"))
