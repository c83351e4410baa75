"""Workers on this computer: each a process with one pipe, replaced when it dies."""

from __future__ import annotations

import multiprocessing
import os
import queue
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from multiprocessing.connection import Connection, wait

from sgp.batch.task import Outcome, Task
from sgp.batch.task_run import perform

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

_SPAWN = multiprocessing.get_context("spawn")
_LOST = 1
# Time for an idle process to end by itself.
_END_S = 5.0


class LocalWorkers:
    """Processes that perform tasks.

    Parameters
    ----------
    count
        Number of processes.
    memory
        Most memory of each process, bytes; None for no limit.
    """

    def __init__(self, count: int, memory: int | None = None) -> None:
        self.count, self._memory = count, memory

    def outcomes(
        self, tasks: Sequence[Task], started: Callable[[Task], None]
    ) -> Iterator[tuple[Task, Outcome]]:
        """Yield each task with its outcome as it ends; ``started`` is called as it begins.

        If the caller stops early, the processes are ended.
        """
        waiting: queue.SimpleQueue[Task] = queue.SimpleQueue()
        for task in tasks:
            waiting.put(task)
        ended: queue.SimpleQueue[tuple[Task, Outcome] | BaseException] = queue.SimpleQueue()
        workers = [_Worker(self._memory) for _ in range(min(self.count, len(tasks)))]

        def work(worker: _Worker) -> None:
            try:
                while not worker.stopped:
                    task = waiting.get_nowait()
                    started(task)
                    ended.put((task, worker.perform(task)))
            except queue.Empty:
                worker.finish()
            except BaseException as error:  # noqa: BLE001 - raised again by the caller's thread
                ended.put(error)

        threads = [threading.Thread(target=work, args=(one,), daemon=True) for one in workers]
        try:
            for thread in threads:
                thread.start()
            for _ in tasks:
                event = ended.get()
                if isinstance(event, BaseException):
                    raise event
                yield event
        finally:
            for worker in workers:
                worker.stop()
            for thread in threads:
                thread.join()


class _Worker:
    """A process that performs one task after another, and its successors."""

    def __init__(self, memory: int | None) -> None:
        self.stopped, self._memory = False, memory
        self._pipe, self._process = self._start()

    def perform(self, task: Task) -> Outcome:
        """Send a task to the process; if it dies, to another one, as often as the task allows."""
        for attempt in range(1, task.attempts + 1):
            try:
                self._pipe.send(task)
                outcome: Outcome = self._pipe.recv()
            except (EOFError, OSError):
                self._process.join()
                lost = replace(_lost(self._process.exitcode), attempts=attempt)
                if self.stopped:
                    break
                self._pipe, self._process = self._start()
            else:
                return outcome
        return lost

    def finish(self) -> None:
        """Let the process end."""
        self._pipe.close()
        self._process.join(_END_S)

    def stop(self) -> None:
        """End the process now."""
        self.stopped = True
        self._process.kill()
        self._process.join()

    def _start(self) -> tuple[Connection, multiprocessing.context.SpawnProcess]:
        here, there = _SPAWN.Pipe()
        process = _SPAWN.Process(target=_serve, args=(there, self._memory), daemon=True)
        process.start()
        there.close()
        return here, process


def _lost(code: int | None) -> Outcome:
    """Return the outcome of a task whose process died."""
    name = f"exit code {code}" if code is None or code >= 0 else signal.Signals(-code).name
    memory = ", perhaps for lack of memory: use fewer --workers" if name == "SIGKILL" else ""
    return Outcome(f"the process that computed it was ended by {name}{memory}", _LOST)


def _serve(pipe: Connection, memory: int | None) -> None:
    """Perform the tasks that arrive, until the pipe is closed or the parent has ended."""
    # Ctrl-C reaches all processes of a terminal; the parent decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    limit_memory(memory)
    while True:
        try:
            task = pipe.recv()
        except EOFError:
            return
        pipe.send(perform(task))


def limit_memory(most: int | None) -> None:
    """Refuse this process more memory than some bytes, where the system has such a limit."""
    if most is not None and resource is not None:
        _, hard = resource.getrlimit(resource.RLIMIT_DATA)
        resource.setrlimit(resource.RLIMIT_DATA, (most, hard))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(_LOST)
