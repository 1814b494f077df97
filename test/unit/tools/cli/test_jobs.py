"""The same work on several recordings at once."""
from __future__ import annotations

import os
from functools import partial

import pytest

from car_interface.common.errors import CarInterfaceError
from car_interface.tools.cli import jobs


def leaving_a_mark(folder, number):
    (folder / str(number)).touch()
    if number == 0:
        raise CarInterfaceError("0 is refused")


@pytest.mark.parametrize("count", [1, 3])
def test_work_in_processes_comes_back_in_order(count):
    with jobs.workers(7, count) as done_by:
        assert list(jobs.for_each(str, range(7), done_by)) == list("0123456")


@pytest.mark.parametrize("count", [1, 2])
def test_error_ends_the_work(count, tmp_path):
    with pytest.raises(CarInterfaceError, match="0 is refused"), jobs.workers(1000, count) as done_by:
        list(jobs.for_each(partial(leaving_a_mark, tmp_path), range(1000), done_by))
    assert len(list(tmp_path.iterdir())) < 500  # of 1000; on a busy machine more are done before it's noticed


def test_process_that_was_killed_is_told():
    with pytest.raises(CarInterfaceError, match="was killed, maybe for want of memory: try again with --jobs 1"), \
            jobs.workers(2, 2) as done_by:
        list(jobs.for_each(os._exit, [9, 9], done_by))
