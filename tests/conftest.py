"""Fixtures for all tests."""

import gc
import os
import signal
import sys
from contextlib import AbstractContextManager
from pathlib import Path

# Before numpy and numba are imported, and for programs that tests start: threads that wait actively
# would take the cores from the other workers. Kernels of this project keep their threads, so that
# faults of parallel code are found.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import pytest
from hypothesis import settings

from tests.compile_once import one_by_one

# On a computer with other load, an example may take any time.
settings.register_profile("without deadline", deadline=None)
settings.load_profile("without deadline")

_WANTED = {"SIGINT": signal.default_int_handler, "SIGHUP": signal.SIG_DFL}


def pytest_configure(config):
    """Let each kernel be compiled by one of the workers of pytest-xdist, also by collection."""
    if not hasattr(config, "workerinput"):
        return
    from numba.core.dispatcher import Dispatcher

    folder = Path(config.cache.mkdir("kernels"))
    patch = pytest.MonkeyPatch()
    patch.setattr(Dispatcher, "compile", one_by_one(Dispatcher.compile, folder))
    config.add_cleanup(patch.undo)


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Collect without the garbage collector, which never again looks at what is there then."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


def pytest_unconfigure():
    """Let the interpreter collect everything when it ends: modules in C report what is left."""
    gc.unfreeze()


def pytest_collection_modifyitems(config, items):
    """Begin with the tests that may take longest, so that no worker is left with one at the end."""
    usual_s = float(config.getini("timeout"))

    def limit_s(item):
        mark = item.get_closest_marker("timeout")
        return max(mark.args[0], usual_s) if mark else usual_s

    items.sort(key=limit_s, reverse=True)


@pytest.fixture(scope="session", autouse=True)
def _signals_work():
    """Restore the default handlers of signals that a shell ignores in background jobs."""
    known = [name for name in _WANTED if hasattr(signal, name)]
    before = [signal.signal(getattr(signal, name), _WANTED[name]) for name in known]
    yield
    for name, handler in zip(known, before, strict=True):
        signal.signal(getattr(signal, name), handler)


@pytest.fixture(scope="session", autouse=True)
def _disks_are_not_awaited():
    """Flush no file: here the power does not fail. Programs that tests start flush theirs."""

    def fsync(descriptor):
        os.fstat(descriptor)  # an error if it is closed

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", fsync)
        yield


@pytest.fixture(scope="session", autouse=True)
def _no_user_configuration(tmp_path_factory):
    """Hide the user's own default rig and operator, also from programs that tests start."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CONFIG_HOME", str(tmp_path_factory.mktemp("no-config")))
        patch.delenv("SGP_RIG", raising=False)
        yield


@pytest.fixture(autouse=True)
def _signals_stay():
    """Restore the handler of SIGINT, which harvesters replaces and does not restore."""
    before = signal.getsignal(signal.SIGINT)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session")
def forks():
    """A server that forks programs, which `tests.forked` describes."""
    if sys.platform != "linux":
        pytest.skip("forks processes")
    from tests.forked import ForkServer

    server = ForkServer()
    yield server
    server.close()


@pytest.fixture(scope="session")
def quick_starts(request):
    """Fork the processes of virtual boards and isolated cameras, where the system can."""
    if sys.platform != "linux":
        yield
        return
    forks = request.getfixturevalue("forks")
    with pytest.MonkeyPatch.context() as patch:
        for module in ("rig.genicam.isolated", "simulator.led_board.virtual_board"):
            patch.setattr(f"{module}.subprocess", forks.as_subprocess)
        yield


@pytest.fixture
def world(tmp_path_factory):
    """A world without faults in whose virtual time the test runs: it waits with `rig.host.clock`.

    Files outside the world are real.
    """
    yield from a_world(tmp_path_factory)


def a_world(tmp_path_factory):
    """Be in a world until the next step of this iterator; for fixtures."""
    from simulator.world import Schedule, World

    world = World(Schedule(0, ()), tmp_path_factory.mktemp("world"), leds=36)
    with world.inside():
        yield world


@pytest.fixture
def simulated_world(world, monkeypatch):
    """Let simulated rigs whose camera is inside use the world instead of a board in a process."""
    from simulator.rigs import bench_rig

    class Connected(AbstractContextManager):
        bench_state_path = None

        def __init__(self, leds):
            world.connect(leds)
            self.port = world.board.port

        def __exit__(self, *_):
            pass

    monkeypatch.setattr(bench_rig, "VirtualBoard", Connected)
    monkeypatch.setattr(bench_rig, "BenchState", lambda path: world.board.view)
