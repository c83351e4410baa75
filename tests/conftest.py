"""Fixtures for all tests."""

import os
import signal

# Before numpy and numba are imported, and for programs that tests start: threads that wait actively
# would take the cores from the other workers.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import pytest

from tests.compile_once import one_by_one

_WANTED = {"SIGINT": signal.default_int_handler, "SIGHUP": signal.SIG_DFL}


@pytest.fixture(scope="session", autouse=True)
def _signals_work():
    """Restore the default handlers of signals that a shell ignores in background jobs."""
    known = [name for name in _WANTED if hasattr(signal, name)]
    before = [signal.signal(getattr(signal, name), _WANTED[name]) for name in known]
    yield
    for name, handler in zip(known, before, strict=True):
        signal.signal(getattr(signal, name), handler)


@pytest.fixture(scope="session", autouse=True)
def _no_user_configuration(tmp_path_factory):
    """Hide the user's own default rig and operator, also from programs that tests start."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CONFIG_HOME", str(tmp_path_factory.mktemp("no-config")))
        patch.delenv("SGP_RIG", raising=False)
        yield


@pytest.fixture(scope="session", autouse=True)
def _workers_compile_one_by_one(tmp_path_factory):
    """Let each kernel be compiled by one of the workers that pytest-xdist starts."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        yield
        return
    from numba.core.dispatcher import Dispatcher

    # The parent of a worker's folder belongs to all workers of the run.
    folder = tmp_path_factory.getbasetemp().parent / "kernels"
    folder.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Dispatcher, "compile", one_by_one(Dispatcher.compile, folder))
        yield


@pytest.fixture(autouse=True)
def _signals_stay():
    """Restore the handler of SIGINT, which harvesters replaces and does not restore."""
    before = signal.getsignal(signal.SIGINT)
    yield
    signal.signal(signal.SIGINT, before)
