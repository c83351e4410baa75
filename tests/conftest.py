"""Fixtures for all tests."""

import signal

import pytest

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


@pytest.fixture(autouse=True)
def _signals_stay():
    """Restore the handler of SIGINT, which harvesters replaces and does not restore."""
    before = signal.getsignal(signal.SIGINT)
    yield
    signal.signal(signal.SIGINT, before)
