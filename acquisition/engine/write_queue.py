"""Background threads that write to the disk while the main thread takes shots."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Generic, TypeVar

from acquisition._errors import StorageError
from rig.host import clock
from rig.host import threads as host_threads

Result = TypeVar("Result")

Turn = Callable[[], None]

_TICK_S = 0.5


class WriteQueue(Generic[Result]):
    """A bounded queue of jobs and the threads that run them in parallel.

    Each job is called with a function that blocks until all earlier jobs are done, and must call it
    exactly once. The code after that call therefore runs in the order of the jobs.

    No job is dropped: before each `put` the owner checks whether the queue is full and waits for
    room. If a job fails, no later job gets its turn, and the earlier ones finish normally. The
    owner receives its error at the next call that reports results or waits. The threads are
    daemons: a disk that never responds cannot keep the program alive.

    While no job waits or runs, one thread does idle work, one piece at a time; other threads stay
    free for a job that arrives meanwhile.

    Parameters
    ----------
    folder
        Folder that the jobs write to, for messages.
    room
        Number of jobs that may run or wait, at least one.
    threads
        Number of threads.
    stall_s
        Longest time without a finished job before the disk counts as stuck, seconds.
    when_idle
        Does one piece of idle work, which only reads; returns False if nothing was left to do.
    """

    def __init__(
        self,
        folder: Path,
        *,
        room: int,
        threads: int,
        stall_s: float,
        when_idle: Callable[[], bool] = lambda: False,
    ) -> None:
        self._folder = folder
        self._room = room
        self._stall_s = stall_s
        self._changed = host_threads.Condition()
        self._waiting: deque[Callable[[Turn], Result]] = deque()
        self._started = 0
        self._finished = 0
        self._ended = False
        self._results: deque[Result] = deque()
        # Successful jobs have consecutive numbers from 0, because each waits for the earlier ones.
        self._succeeded = 0
        self._failed: float = math.inf
        self._error: BaseException | None = None
        self._moved_s = 0.0
        self._when_idle = when_idle
        self._idle_left = True
        self._idle_since_s: float | None = None
        self._threads = [
            host_threads.Thread(target=self._work, name=f"writer {number}", daemon=True)
            for number in range(threads)
        ]
        for thread in self._threads:
            thread.start()

    @property
    def full(self) -> bool:
        """Whether there is no room for another job."""
        return self._waits >= self._room

    @property
    def settled(self) -> bool:
        """Whether no job waits or runs, and `results` has nothing to return or raise."""
        with self._changed:
            return not (self._waits or self._results or self._error)

    def put(self, job: Callable[[Turn], Result]) -> None:
        """Add a job immediately, even to a full queue: the caller waits for room before.

        After a failure the job is discarded, because it would never get its turn.
        """
        with self._changed:
            if not self._ended:
                self._waiting.append(job)
                self._changed.notify_all()

    def results(self) -> list[Result]:
        """Return the results of the jobs that finished since the last call.

        If no job finished and one failed, raise its error; earlier jobs may still be running, and
        `drain` waits for them.
        """
        with self._changed:
            results = list(self._results)
            self._results.clear()
            if not results and self._error is not None:
                raise self._error
            return results

    def wait_for_room(self) -> None:
        """Wait until half of the room is free, or a job has failed.

        Raises
        ------
        StorageError
            If no job finishes for too long.
        """
        self._wait(lambda: self._waits <= self._room // 2 or self._error is not None)

    def drain(self, patience_s: float = math.inf) -> None:
        """Wait at most ``patience_s`` until every job is done; after a failure, the running ones.

        Raises the same errors as `wait_for_room`.
        """
        ends_s = clock.monotonic() + patience_s
        self._wait(lambda: self._waits == 0 or clock.monotonic() >= ends_s)

    def rests(self, patience_s: float) -> bool:
        """Wait at most ``patience_s``; return whether all jobs and all idle work are done.

        Raises
        ------
        StorageError
            If a piece of idle work takes too long.
        BaseException
            The error of a job or of the idle work.
        """
        ends_s = clock.monotonic() + patience_s
        with self._changed:
            while (self._idle_left or self._waits) and self._error is None:
                now_s = clock.monotonic()
                if self._idle_since_s is not None and now_s - self._idle_since_s > self._stall_s:
                    raise StorageError(
                        f"{self._folder}: reading a frame back has taken "
                        f"{now_s - self._idle_since_s:.1f} s; find out what blocks the disk, then "
                        "resume"
                    )
                if now_s >= ends_s:
                    return False
                self._changed.wait(ends_s - now_s)
            if self._error is not None:
                raise self._error
            return True

    def end(self, patience_s: float) -> bool:
        """Discard waiting jobs, and wait at most ``patience_s`` for the running ones.

        Returns
        -------
        bool
            False if a job is still running.
        """
        ends_s = clock.monotonic() + patience_s
        with self._changed:
            self._ended = True
            self._waiting.clear()
            self._changed.notify_all()
            while self._started > self._finished and (left_s := ends_s - clock.monotonic()) > 0:
                self._changed.wait(left_s)
            return self._started == self._finished

    @property
    def _waits(self) -> int:
        return len(self._waiting) + self._started - self._finished

    def _wait(self, until: Callable[[], bool]) -> None:
        began_s = clock.monotonic()
        with self._changed:
            while not until():
                stalled_s = clock.monotonic() - max(began_s, self._moved_s)
                if stalled_s > self._stall_s:
                    raise StorageError(
                        f"{self._folder}: no write has finished for {stalled_s:.1f} s, "
                        f"{self._waits} writes are waiting; find out what blocks the disk, then "
                        "resume"
                    )
                self._changed.wait(min(_TICK_S, self._stall_s))

    def _work(self) -> None:
        while (taken := self._next()) is not None:
            number, job = taken
            if job is None:
                self._idle()
                continue
            try:
                result = job(partial(self._wait_for_turn, number))
            except BaseException as error:  # noqa: BLE001 - raised again in the owner's thread
                self._fail(number, error)
            else:
                self._succeed(result)
                del result
            # Free the frame with its job, not when the next one arrives.
            del job, taken

    def _next(self) -> tuple[int, Callable[[Turn], Result] | None] | None:
        """Return the next job, None in its place for idle work, or None at the end."""
        with self._changed:
            while not self._waiting and not self._ended:
                if self._idle_left and self._idle_since_s is None and self._waits == 0:
                    self._idle_since_s = clock.monotonic()
                    return 0, None
                self._changed.wait()
            if self._ended:
                return None
            self._started += 1
            return self._started - 1, self._waiting.popleft()

    def _idle(self) -> None:
        try:
            left, error = self._when_idle(), None
        except BaseException as failure:  # noqa: BLE001 - raised again in the owner's thread
            left, error = False, failure
        with self._changed:
            self._idle_left, self._idle_since_s = left, None
            if error is not None and self._error is None:
                # Running jobs may finish.
                self._failed, self._error = self._started - 0.5, error
                self._ended = True
                self._waiting.clear()
            self._changed.notify_all()

    def _wait_for_turn(self, number: int) -> None:
        with self._changed:
            while self._succeeded < number < self._failed:
                self._changed.wait()
            if number > self._failed:
                raise StorageError(f"{self._folder}: an earlier write failed")

    def _succeed(self, result: Result) -> None:
        with self._changed:
            self._results.append(result)
            self._succeeded += 1
            self._end_one()

    def _fail(self, number: int, error: BaseException) -> None:
        with self._changed:
            if number < self._failed:
                self._failed, self._error = number, error
            self._ended = True
            self._waiting.clear()
            self._end_one()

    def _end_one(self) -> None:
        self._finished += 1
        self._moved_s = clock.monotonic()
        self._changed.notify_all()
