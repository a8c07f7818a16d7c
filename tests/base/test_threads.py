import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import pytest

from dds_trace.base.threads import FastLock, InlineExecutor, in_order


def results(jobs, threads=2, most_jobs=4, most_size=100):
    with ThreadPoolExecutor(threads) as pool:
        return list(in_order(jobs, pool, most_jobs, most_size))


def test_results_keep_the_order_of_their_jobs():
    assert results((1, partial(pow, n, 2)) for n in range(500)) == [n * n for n in range(500)]


def test_no_job_is_no_result():
    assert results([]) == []


def test_an_executor_without_threads_does_each_job_at_once():
    done = []
    assert InlineExecutor().submit(done.append, 1).result() is None
    assert done == [1]
    with pytest.raises(ZeroDivisionError):
        InlineExecutor().submit(divmod, 1, 0)


def test_who_waits_does_the_jobs_that_nobody_has_begun():
    busy = threading.Event()
    with ThreadPoolExecutor(1) as pool:
        pool.submit(busy.wait, 60)
        done_by = list(in_order([(1, threading.current_thread)] * 10, pool, 4, 100))
        busy.set()
    assert set(done_by) == {threading.current_thread()}


@pytest.mark.parametrize(("most_jobs", "most_size", "size", "held"), [(3, 100, 1, 3), (50, 10, 4, 2), (50, 10, 40, 1)])
def test_no_more_is_begun_than_may_be(most_jobs, most_size, size, held):
    begun, handed_out = [], 0

    def job(number):
        begun.append(number)

    with ThreadPoolExecutor(2) as pool:
        for _ in in_order(((size, partial(job, n)) for n in range(40)), pool, most_jobs, most_size):
            assert len(begun) - handed_out <= held
            handed_out += 1
    assert sorted(begun) == list(range(40))


@pytest.mark.parametrize("threads", [1, 2])
def test_the_failure_of_a_job_is_raised(threads):
    def fail():
        raise OSError(5, "the device is gone")

    with pytest.raises(OSError, match="the device is gone"):
        results([(1, int)] * 5 + [(1, fail)] + [(1, int)] * 5, threads)


def test_jobs_that_nobody_wants_any_more_never_begin():
    begun, busy = [], threading.Event()
    with ThreadPoolExecutor(1) as pool:
        pool.submit(busy.wait)  # so the first job is done here, and no other begins
        results = in_order([(1, int), *[(1, partial(begun.append, 1))] * 2], pool, 3, 3)
        assert next(results) == 0
        results.close()
        busy.set()
    assert begun == []


@pytest.fixture
def _quick_switches():
    interval_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(interval_s)


@pytest.mark.usefixtures("_quick_switches")
def test_one_thread_at_a_time_has_its_turn():
    turn, total, inside = FastLock(), [0], []

    def add():
        for _ in range(2000):
            with turn:
                inside.append(1)
                before = total[0]
                assert len(inside) == 1
                total[0] = before + 1
                inside.pop()

    with ThreadPoolExecutor(4) as pool:
        for done in [pool.submit(add) for _ in range(4)]:
            done.result()
    assert total == [8000]
    assert not turn.is_awaited


def test_who_waits_for_a_turn_is_told():
    turn, had = FastLock(), []

    def take_turn():
        with turn:
            had.append(1)

    turn.take()
    waiting = [threading.Thread(target=take_turn) for _ in range(3)]
    for thread in waiting:
        thread.start()
    while not turn.is_awaited:
        time.sleep(0.001)
    assert not had
    turn.give(None)
    turn.wake()
    for thread in waiting:
        thread.join(60)
    assert had == [1, 1, 1]


def test_a_turn_is_given_back_behind_an_error():
    turn = FastLock()
    with pytest.raises(KeyError), turn:
        raise KeyError
    turn.take()
