"""Work for the disk, done beside the thread that holds the light."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Generic, TypeVar

from acquisition._errors import StorageError

Result = TypeVar("Result")

Turn = Callable[[], None]

_TICK_S = 0.5


class WriteQueue(Generic[Result]):
    """A bounded queue of jobs and the threads that do them, several at a time.

    A job is called with a function that returns when it is its turn: every job before it is done.
    So what follows that call is done in order. Each job calls it once.

    Nothing is ever dropped: the owner looks whether it is full, and waits for room, before each
    `put`. A job that fails ends the work: no later one gets its turn, those before it are done as
    if nothing had happened. Its error comes out wherever the owner asks next. The threads do not
    keep the program alive, so that a disk that never answers cannot either.

    While no job waits or is under way, one thread does other work, a piece at a time; a job that
    comes meanwhile finds another thread free.

    Parameters
    ----------
    folder
        Where the jobs write, for messages.
    room
        Jobs that may be under way or waiting, at least one.
    threads
        How many work at once.
    stall_s
        Longest time without any job being done before the disk counts as stuck.
    when_idle
        Does a piece of the other work; False where none was left. It only reads.
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
        self._changed = threading.Condition()
        self._waiting: deque[Callable[[Turn], Result]] = deque()
        self._begun = 0
        self._finished = 0
        self._ended = False
        self._results: deque[Result] = deque()
        # Jobs done well are the first ones without a gap, as each waits for those before it.
        self._well = 0
        self._failed: float = math.inf
        self._error: BaseException | None = None
        self._moved_s = 0.0
        self._when_idle = when_idle
        self._idle_left = True
        self._idle_since_s: float | None = None
        self._threads = [
            threading.Thread(target=self._work, name=f"writer {number}", daemon=True)
            for number in range(threads)
        ]
        for thread in self._threads:
            thread.start()

    @property
    def full(self) -> bool:
        """True where one more job would be one too many."""
        return self._waits >= self._room

    @property
    def settled(self) -> bool:
        """True where nothing waits or is under way, and `results` has nothing to tell."""
        with self._changed:
            return not (self._waits or self._results or self._error)

    def put(self, job: Callable[[Turn], Result]) -> None:
        """Add a job at once, even to a full queue: the caller has waited for room before.

        After a failure it is forgotten, as it would never get its turn.
        """
        with self._changed:
            if not self._ended:
                self._waiting.append(job)
                self._changed.notify_all()

    def results(self) -> list[Result]:
        """Return what jobs gave since this was asked last.

        Where there is nothing to tell, the error of a job that failed is raised; jobs before it may
        still be under way, for which `drain` waits.
        """
        with self._changed:
            found = list(self._results)
            self._results.clear()
            if not found and self._error is not None:
                raise self._error
            return found

    def wait_for_room(self) -> None:
        """Wait until half of the room is free, or a job has failed.

        Raises
        ------
        StorageError
            If nothing is done for too long.
        """
        self._wait(lambda: self._waits <= self._room // 2 or self._error is not None)

    def drain(self, patience_s: float = math.inf) -> None:
        """Wait until every job is done, or for so long; after a failure, those under way.

        Raises as `wait_for_room`.
        """
        ends_s = time.monotonic() + patience_s
        self._wait(lambda: self._waits == 0 or time.monotonic() >= ends_s)

    def rests(self, patience_s: float) -> bool:
        """Wait for so long at most; tell whether all jobs and all of the other work are done.

        Raises
        ------
        StorageError
            If a piece of it takes too long.
        BaseException
            What a job or the other work raised.
        """
        ends_s = time.monotonic() + patience_s
        with self._changed:
            while (self._idle_left or self._waits) and self._error is None:
                now_s = time.monotonic()
                if self._idle_since_s is not None and now_s - self._idle_since_s > self._stall_s:
                    raise StorageError(
                        f"{self._folder}: the disk has not given back a frame for "
                        f"{now_s - self._idle_since_s:.1f} s; find out what blocks it, then resume"
                    )
                if now_s >= ends_s:
                    return False
                self._changed.wait(ends_s - now_s)
            if self._error is not None:
                raise self._error
            return True

    def end(self, patience_s: float) -> bool:
        """Forget jobs that wait, and give those under way so long to end.

        Returns
        -------
        bool
            False where one is still at it.
        """
        ends_s = time.monotonic() + patience_s
        with self._changed:
            self._ended = True
            self._waiting.clear()
            self._changed.notify_all()
            while self._begun > self._finished and (left_s := ends_s - time.monotonic()) > 0:
                self._changed.wait(left_s)
            return self._begun == self._finished

    @property
    def _waits(self) -> int:
        return len(self._waiting) + self._begun - self._finished

    def _wait(self, until: Callable[[], bool]) -> None:
        began_s = time.monotonic()
        with self._changed:
            while not until():
                stands_s = time.monotonic() - max(began_s, self._moved_s)
                if stands_s > self._stall_s:
                    raise StorageError(
                        f"{self._folder}: the disk has taken no frame for {stands_s:.1f} s, "
                        f"{self._waits} writes are waiting; find out what blocks it, then resume"
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
            except BaseException as error:  # noqa: BLE001 - raised again where it is asked for
                self._fail(number, error)
            else:
                self._succeed(result)
                del result
            # A frame must go with its job, not with the next one.
            del job, taken

    def _next(self) -> tuple[int, Callable[[Turn], Result] | None] | None:
        """Return a job, or None in its place where there is time for other work."""
        with self._changed:
            while not self._waiting and not self._ended:
                if self._idle_left and self._idle_since_s is None and self._waits == 0:
                    self._idle_since_s = time.monotonic()
                    return 0, None
                self._changed.wait()
            if self._ended:
                return None
            self._begun += 1
            return self._begun - 1, self._waiting.popleft()

    def _idle(self) -> None:
        try:
            left, error = self._when_idle(), None
        except BaseException as failure:  # noqa: BLE001 - raised again where it is asked for
            left, error = False, failure
        with self._changed:
            self._idle_left, self._idle_since_s = left, None
            if error is not None and self._error is None:
                # Jobs under way may end.
                self._failed, self._error = self._begun - 0.5, error
                self._ended = True
                self._waiting.clear()
            self._changed.notify_all()

    def _wait_for_turn(self, number: int) -> None:
        with self._changed:
            while self._well < number < self._failed:
                self._changed.wait()
            if number > self._failed:
                raise StorageError(f"{self._folder}: what came before could not be written")

    def _succeed(self, result: Result) -> None:
        with self._changed:
            self._results.append(result)
            self._well += 1
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
        self._moved_s = time.monotonic()
        self._changed.notify_all()
