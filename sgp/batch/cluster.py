"""Workers of a Dask cluster, which Dask's own commands have started."""

from __future__ import annotations

import logging
import os
import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import acquisition
from sgp.batch.task import Outcome, Task
from sgp.batch.task_run import perform
from sgp.cli.exit import ClusterError, UsageError

if TYPE_CHECKING:
    from distributed import Client

# Time for a scheduler to answer.
_CONNECT_S = 5.0
# A scheduler with thousands of tasks may be busy for seconds.
_ASK_EVERY_S, _ANSWER_S = 10.0, 60.0
_LOST = 1


class ClusterWorkers:
    """The workers of a Dask cluster.

    Parameters
    ----------
    client
        The connection to the scheduler.
    address
        Its address.
    count
        Number of workers.
    """

    def __init__(self, client: Client, address: str, count: int) -> None:
        self._client, self._address, self.count = client, address, count

    def outcomes(
        self, tasks: Sequence[Task], started: Callable[[Task], None]
    ) -> Iterator[tuple[Task, Outcome]]:
        """Yield each task with its outcome as it ends; ``started`` is called as it begins.

        If the caller stops early, tasks that wait are taken back.

        Raises
        ------
        ClusterError
            If the connection to the scheduler is lost.
        """
        from distributed import Future, as_completed

        run = uuid.uuid4().hex[:8]
        futures: dict[Future, Task] = {}
        for task in tasks:
            started(task)
            key = f"sgp-{run}-{task.name}"
            futures[self._client.submit(perform, task, key=key, pure=False, retries=0)] = task
        try:
            threading.Thread(target=_close_if_silent, args=(self._client,), daemon=True).start()
            for future in as_completed(list(futures)):
                try:
                    error = future.exception()
                except CancelledError as cancelled:
                    error = cancelled
                if self._client.status != "running":
                    raise ClusterError(
                        f"{self._address}: the scheduler is gone: start it and its workers, then "
                        "run the command again"
                    )
                task = futures.pop(future)
                yield task, (future.result() if error is None else _lost(error))
        finally:
            if self._client.status == "running":
                self._client.cancel(list(futures))


def _close_if_silent(client: Client) -> None:
    """Close a connection that is open, but to a scheduler that no longer answers."""
    while client.status == "running":
        try:
            client.sync(client.scheduler.identity, callback_timeout=_ANSWER_S)
        except Exception:  # noqa: BLE001 - whatever it is, there is no answer
            client.close(timeout=1)
        time.sleep(_ASK_EVERY_S)


def check_scheduler(address: str) -> None:
    """Refuse an address at which nothing listens, before Dask is imported, which takes seconds.

    Raises
    ------
    UsageError
        If it is not an address, or the extra ``cluster`` is not installed.
    ClusterError
        If nothing answers.
    """
    if find_spec("distributed") is None:
        text = "--scheduler needs Dask: pip install 'surface-geometry-processing[cluster]'"
        raise UsageError(text)
    try:
        place = urlsplit(address if "://" in address else f"tcp://{address}")
        host, port = place.hostname, place.port
    except ValueError:
        host = port = None
    if not host or not port:
        text = f"--scheduler {address} is not an address: give one such as tcp://10.0.0.5:8786"
        raise UsageError(text)
    try:
        socket.create_connection((host, port), timeout=_CONNECT_S).close()
    except OSError as error:
        raise _unanswered(address) from error


@contextmanager
def cluster(address: str, folder: Path) -> Iterator[ClusterWorkers]:
    """Connect to a scheduler, and check that all workers can do the work.

    Raises
    ------
    UsageError
        If a worker has another version of the software, or more than one thread.
    ClusterError
        If the scheduler does not answer, has no workers, or one of them does not see ``folder``.
    """
    from distributed import Client

    # What Dask logs about a lost connection becomes one error of ours.
    for name in list(logging.root.manager.loggerDict):
        if name.partition(".")[0] == "distributed":
            logging.getLogger(name).disabled = True
    try:
        client = Client(address, timeout=_CONNECT_S)
    except (OSError, ValueError) as error:
        raise _unanswered(address) from error
    with client:
        try:
            count = _checked(client, address, folder)
        except (OSError, TimeoutError, CancelledError) as error:
            raise _unanswered(address) from error
        yield ClusterWorkers(client, address, count)


def _unanswered(address: str) -> ClusterError:
    return ClusterError(f"{address}: the scheduler does not answer: start it with `dask scheduler`")


def _checked(client: Client, address: str, folder: Path) -> int:
    """Check that all workers can do the work; return their number."""
    workers = client.scheduler_info(n_workers=-1)["workers"]
    if not workers:
        text = f"{address}: has no workers: start some with `dask worker {address} --nthreads 1`"
        raise ClusterError(text)
    busy = next((name for name, one in workers.items() if one["nthreads"] != 1), None)
    if busy is not None:
        raise UsageError(
            f"{busy}: this worker has {workers[busy]['nthreads']} threads: start it with "
            "--nthreads 1, and more workers with --nworkers"
        )
    token = folder / f".seen-{uuid.uuid4().hex[:8]}"
    acquisition.write_durably(token, token.name.encode())
    try:
        answers = client.run(_probe, str(token), on_error="return")
    finally:
        with suppress(OSError):
            token.unlink()
    here = acquisition.files.software_version()
    for name, answer in answers.items():
        if isinstance(answer, BaseException):
            raise ClusterError(f"{name}: this worker cannot run sgp: {answer}")
        version, seen = answer
        if version != here:
            text = f"{name}: this worker has version {version} of sgp, here is {here}"
            raise UsageError(f"{text}: install the same version")
        if not seen:
            text = f"{name}: this worker does not see {folder}"
            raise ClusterError(f"{text}: mount the storage there under the same path")
    return len(answers)


def _probe(token: str) -> tuple[str, bool]:
    """Return the version of the software of a worker, and whether it sees and may write a file."""
    path = Path(token)
    try:
        seen = path.read_bytes() == path.name.encode() and os.access(path.parent, os.W_OK)
    except OSError:
        seen = False
    return acquisition.files.software_version(), seen


def _lost(error: Any) -> Outcome:
    text = " ".join(str(error).split())
    return Outcome(f"the cluster did not complete it: {type(error).__name__}: {text}", _LOST)
