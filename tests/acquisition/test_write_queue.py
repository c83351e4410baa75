from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from acquisition import StorageError
from acquisition.engine.write_queue import Turn, WriteQueue
from rig.host import clock
from simulator.world import World

FOLDER = Path("session")


@pytest.fixture
def queue() -> Iterator[WriteQueue[int]]:
    queue: WriteQueue[int] = WriteQueue(FOLDER, room=4, threads=2, stall_s=0.4)
    yield queue
    queue.end(5)


@pytest.fixture
def virtual_queue(world: World) -> Iterator[WriteQueue[int]]:
    """A queue in virtual time."""
    queue: WriteQueue[int] = WriteQueue(FOLDER, room=4, threads=2, stall_s=0.4)
    yield queue
    queue.end(5)


def settled(queue: WriteQueue[int]) -> list[int]:
    queue.drain()
    return queue.results()


def test_results_have_the_order_of_the_jobs(queue: WriteQueue[int]) -> None:
    written: list[int] = []

    def job(number: int, turn: Turn) -> int:
        clock.sleep(0.01 if number % 2 else 0)  # the odd ones finish later
        turn()
        written.append(number)
        return number

    for number in range(20):
        queue.put(lambda turn, number=number: job(number, turn))
    assert settled(queue) == list(range(20))
    assert written == list(range(20))
    assert queue.settled


def test_jobs_run_in_parallel(queue: WriteQueue[int]) -> None:
    together = threading.Barrier(2, timeout=60)

    def job(turn: Turn) -> int:
        together.wait()
        turn()
        return 1

    queue.put(job)
    queue.put(job)
    assert settled(queue) == [1, 1]


def test_the_queue_is_full_until_half_of_its_room_is_free(queue: WriteQueue[int]) -> None:
    gate = threading.Event()

    def job(turn: Turn) -> int:
        assert gate.wait(60)
        turn()
        return 1

    for number in range(4):
        assert not queue.full, number
        queue.put(job)
    assert queue.full
    threading.Timer(0.05, gate.set).start()
    queue.wait_for_room()
    assert len(queue.results()) >= 2


def test_results_are_returned_before_the_error(queue: WriteQueue[int]) -> None:
    def fine(turn: Turn) -> int:
        turn()
        return 7

    def fails(turn: Turn) -> int:
        turn()
        raise ZeroDivisionError("no")

    queue.put(fine)
    queue.put(fails)
    queue.put(fine)
    queue.drain()
    assert not queue.settled
    assert queue.results() == [7]
    with pytest.raises(ZeroDivisionError):
        queue.results()
    with pytest.raises(ZeroDivisionError):
        queue.results()


def test_nothing_is_written_after_a_job_that_failed(queue: WriteQueue[int]) -> None:
    """Even by a running job: its data would follow the missing piece."""
    second_waits = threading.Event()
    written: list[int] = []

    def first(turn: Turn) -> int:
        assert second_waits.wait(60)
        raise StorageError("disk full")

    def second(turn: Turn) -> int:
        second_waits.set()
        turn()
        written.append(2)
        return 2

    queue.put(first)
    queue.put(second)
    queue.drain()
    assert queue.end(10)
    assert written == []
    with pytest.raises(StorageError, match="disk full"):
        queue.results()


def test_a_job_that_never_ends_is_reported(virtual_queue: WriteQueue[int]) -> None:
    queue = virtual_queue

    def job(turn: Turn) -> int:
        clock.sleep(5)
        turn()
        return 1

    queue.put(job)
    with pytest.raises(StorageError, match=r"session: no write has finished for 0\.\d s, 1 "):
        queue.drain()
    assert not queue.end(0.05)
    assert queue.end(10)


def test_a_slow_disk_is_not_stuck(virtual_queue: WriteQueue[int]) -> None:
    queue = virtual_queue

    def job(turn: Turn) -> int:
        clock.sleep(0.25)
        turn()
        return 1

    for _ in range(4):
        queue.put(job)
    assert settled(queue) == [1] * 4


def test_the_end_discards_waiting_jobs(queue: WriteQueue[int]) -> None:
    gate = threading.Event()
    started: list[int] = []

    def job(number: int, turn: Turn) -> int:
        started.append(number)
        assert gate.wait(60)
        turn()
        return number

    for number in range(4):
        queue.put(lambda turn, number=number: job(number, turn))
    while len(started) < 2:
        time.sleep(0.001)
    threading.Timer(0.05, gate.set).start()
    assert queue.end(10)
    assert started == [0, 1]


@pytest.mark.parametrize("failing", [1, 2])
def test_jobs_before_a_failure_finish(failing: int) -> None:
    """Jobs before the failed one finish in order; their results are returned before its error."""
    queue: WriteQueue[int] = WriteQueue(FOLDER, room=4, threads=3, stall_s=20)
    failed, all_started = threading.Event(), threading.Barrier(3, timeout=60)
    written: list[int] = []

    def job(number: int, turn: Turn) -> int:
        all_started.wait()
        if number == failing:
            failed.set()
            raise StorageError("disk full")
        assert failed.wait(60)
        # The later jobs ask for their turn first; the failure must be recorded by then.
        time.sleep(0.03 if number else 0.1)
        turn()
        written.append(number)
        return number

    for number in range(3):
        queue.put(lambda turn, number=number: job(number, turn))
    queue.drain()
    assert written == queue.results() == list(range(failing))
    with pytest.raises(StorageError, match="disk full"):
        queue.results()
    assert queue.end(20)


def test_jobs_after_a_failure_do_not_block_the_caller(queue: WriteQueue[int]) -> None:
    def fails(turn: Turn) -> int:
        raise ZeroDivisionError("no")

    queue.put(fails)
    queue.drain()
    queue.put(fails)
    queue.drain()
    assert not queue.full
    with pytest.raises(ZeroDivisionError):
        queue.results()
