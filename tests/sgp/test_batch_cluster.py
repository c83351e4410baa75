"""``sgp batch --scheduler``: a real Dask scheduler with workers, and clusters that do not fit."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from copy import copy
from pathlib import Path
from types import SimpleNamespace

import pytest

import acquisition
from sgp.batch import Outcome, cluster
from sgp.batch.cluster import _checked, _probe
from sgp.cli.exit import ClusterError, UsageError
from tests.cases import cases
from tests.sgp.test_cli_batch import recipe as recipe
from tests.sgp.test_cli_batch import table, wait_for
from tests.sgp.test_cli_batch import two as two

ADDRESS = "tcp://127.0.0.1:8786"
HERE = acquisition.files.software_version()


class Cluster:
    """What `_checked` uses of a client."""

    def __init__(self, threads: int | None = 1, answer: object = None) -> None:
        self._workers = {} if threads is None else {"tcp://w:1": {"nthreads": threads}}
        self._answer = answer

    def scheduler_info(self, n_workers: int) -> dict:
        return {"workers": self._workers}

    def run(self, function, token, on_error):
        assert function(token) == (HERE, True)
        return {"tcp://w:1": self._answer}


@cases(
    ("client", "error", "message"),
    {
        "no workers": (Cluster(None), ClusterError, "has no workers: start some"),
        "threads": (Cluster(4), UsageError, "w:1: this worker has 4 threads"),
        "version": (Cluster(answer=("0.0", True)), UsageError, "has version 0.0 of sgp, here"),
        "storage": (Cluster(answer=(HERE, False)), ClusterError, "does not see .*: mount"),
        "not installed": (
            Cluster(answer=ModuleNotFoundError("No module named 'sgp'")),
            ClusterError,
            "cannot run sgp: No module named 'sgp'",
        ),
    },
)
def test_workers_that_cannot_do_the_work_are_named(client, error, message, tmp_path) -> None:
    with pytest.raises(error, match=message):
        _checked(client, ADDRESS, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_good_cluster_is_accepted(tmp_path) -> None:
    assert _checked(Cluster(answer=(HERE, True)), ADDRESS, tmp_path) == 1
    assert _probe(str(tmp_path / "missing")) == (HERE, False)


class Lost:
    """A client whose scheduler dies after some tasks."""

    status = "running"
    scheduler = SimpleNamespace(identity=None)

    def __init__(self, good: int) -> None:
        self.good, self.cancelled = good, False

    def submit(self, function, task, **_: object) -> Lost:
        return self

    def cancel(self, futures) -> None:
        self.cancelled = True

    def sync(self, function, callback_timeout: float) -> None:
        """Answer as a scheduler does."""

    def close(self, timeout: float) -> None:
        self.status = "closed"

    def exception(self) -> None:
        self.good -= 1
        if self.good < 0:
            self.status = "closed"
            raise CancelledError("scheduler-connection-lost")

    def result(self) -> Outcome:
        return Outcome()


def test_a_lost_scheduler_is_one_error_and_the_tables_are_written(
    sgp, two, tmp_path, monkeypatch
) -> None:
    monkeypatch.setattr("sgp.commands.batch.check_scheduler", lambda address: None)
    client = Lost(good=1)

    @contextmanager
    def connected(address: str, folder: Path) -> Iterator[cluster.ClusterWorkers]:
        yield cluster.ClusterWorkers(client, address, 1)

    monkeypatch.setattr("sgp.commands.batch.cluster", connected)
    # The client stands for its futures, too, which must differ.
    kinds = iter([client, copy(client)])
    monkeypatch.setattr(client, "submit", lambda *_, **__: next(kinds))
    monkeypatch.setattr("distributed.as_completed", lambda futures: [client, client])
    out = tmp_path / "out"
    answer = sgp("batch", *two, "--out", out, "--scheduler", ADDRESS)
    assert answer.code == 3
    assert answer.err.splitlines()[-1] == (
        f"error: {ADDRESS}: the scheduler is gone: start it and its workers, then run the command "
        "again"
    )
    assert {row["status"] for row in table(out).values()} == {"done", "failed"}


def test_a_scheduler_that_no_longer_answers_is_given_up(monkeypatch) -> None:
    def silent(function, callback_timeout: float) -> None:
        raise TimeoutError

    client = Lost(good=0)
    monkeypatch.setattr(client, "sync", silent)
    monkeypatch.setattr(cluster, "_ASK_EVERY_S", 0)
    cluster._close_if_silent(client)
    assert client.status == "closed"


def test_without_dask_the_extra_is_named(sgp, two, tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    words = ["batch", *two, "--out", tmp_path / "out", "--scheduler", ADDRESS]
    assert "pip install 'surface-geometry-processing[cluster]'" in sgp(*words).error_line(2)


@pytest.mark.parametrize("listens", [False, True])
def test_a_scheduler_that_does_not_answer_costs_no_import(
    sgp, two, tmp_path, monkeypatch, listens
) -> None:
    monkeypatch.setattr(cluster, "_CONNECT_S", 0.2)
    monkeypatch.setitem(sys.modules, "distributed", SimpleNamespace(__spec__=True))  # no Client
    with socket.create_server(("127.0.0.1", 0), backlog=0) as server:
        place = server.getsockname()
        if not listens:
            server.close()
            waiting = []
        else:  # the system drops further connections, like a host that is switched off
            waiting = [socket.create_connection(place)]
        words = ["batch", *two, "--out", tmp_path / "out"]
        address = f"tcp://127.0.0.1:{place[1]}"
        text = sgp(*words, "--scheduler", address).error_line(3)
        for one in waiting:
            one.close()
    assert text.endswith(
        f"{address}: the scheduler does not answer: start it with `dask scheduler`"
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("address", ["10.0.0.5", "tcp://:8786", "tcp://10.0.0.5:many", "[::1"])
def test_a_wrong_address_is_refused(sgp, two, tmp_path, address) -> None:
    words = ["batch", *two, "--out", tmp_path / "out", "--scheduler", address]
    text = sgp(*words).error_line(2)
    assert text.endswith(
        f"--scheduler {address} is not an address: give one such as tcp://10.0.0.5:8786"
    )


def dask(*words: object, folder: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "dask", *map(str, words), "--host", "127.0.0.1"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen([*command, "--no-dashboard"], cwd=folder, **quiet)


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory) -> Iterator[SimpleNamespace]:
    """A scheduler with two workers, one of which may be killed."""
    from distributed import Client

    folder = tmp_path_factory.mktemp("dask")
    file = folder / "scheduler.json"
    running = [dask("scheduler", "--port", 0, "--scheduler-file", file, folder=folder)]
    try:
        wait_for(file.exists)
        address = json.loads(file.read_text())["address"]
        one = ("worker", address, "--nthreads", 1, "--no-nanny")
        running += [dask(*one, folder=folder), dask(*one, folder=folder)]
        with Client(address) as client:
            client.wait_for_workers(2, timeout=100)
        yield SimpleNamespace(address=address, workers=running[1:])
    finally:
        for process in running[::-1]:
            process.kill()
            process.wait()


def batch(*words: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "sgp", "batch", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=280, check=False)


@pytest.mark.slow
def test_a_cluster_gives_the_same_results_and_survives_the_loss_of_a_worker(
    scheduler, two, recipe, tmp_path
) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    assert batch(*two, "--out", here, "--recipe", recipe).returncode == 0
    done = batch(*two, "--out", there, "--recipe", recipe, "--scheduler", scheduler.address)
    assert done.returncode == 0, done.stderr
    for name in ("ball", "bright"):
        for path in ("normals/normals.exr", "surface/height.exr", "detail/detail.exr"):
            assert (there / name / path).read_bytes() == (here / name / path).read_bytes()
    lost = tmp_path / "lost"
    words = [*two, "--out", lost, "--recipe", recipe, "--scheduler", scheduler.address]
    command = [sys.executable, "-m", "sgp", "batch", *map(str, words)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as run:
        wait_for(lambda: len(list((lost / "state").glob("*.log"))) == 2)
        scheduler.workers[0].send_signal(signal.SIGKILL)
        _, errors = run.communicate(timeout=280)
    assert run.returncode == 0, errors
    assert {row["status"] for row in table(lost).values()} == {"done"}


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer(two, tmp_path) -> None:
    done = batch(*two, "--out", tmp_path / "out", "--scheduler", "tcp://127.0.0.1:9")
    assert done.returncode == 3
    assert "the scheduler does not answer" in done.stderr
    assert len(done.stderr.splitlines()) == 1, done.stderr
