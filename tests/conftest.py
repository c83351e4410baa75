"""What every test stands on."""

import signal

import pytest

_WANTED = {"SIGINT": signal.default_int_handler, "SIGHUP": signal.SIG_DFL}


@pytest.fixture(scope="session", autouse=True)
def _signals_work():
    """Let signals strike that a shell ignores for what it runs in the background."""
    known = [name for name in _WANTED if hasattr(signal, name)]
    before = [signal.signal(getattr(signal, name), _WANTED[name]) for name in known]
    yield
    for name, handler in zip(known, before, strict=True):
        signal.signal(getattr(signal, name), handler)


@pytest.fixture(autouse=True)
def _signals_stay():
    """Put back the handler of SIGINT: harvesters, used by itself, takes it and keeps it."""
    before = signal.getsignal(signal.SIGINT)
    yield
    signal.signal(signal.SIGINT, before)
