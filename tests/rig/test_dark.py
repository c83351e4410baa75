"""Signal handlers that turn the LEDs off: what they call, and when they are restored."""

import os
import signal
import threading

import pytest

from rig.shooting import lights_off as dark
from rig.shooting.lights_off import watch


@pytest.fixture
def handlers():
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.getsignal(number) for number in numbers]
    yield lambda: [signal.getsignal(number) for number in numbers]
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


def test_handlers_are_restored_with_the_last_watch(handlers):
    before = handlers()
    first, second = watch(lambda: None), watch(lambda: None)
    assert handlers()[1] is not before[1]
    first()
    first()
    assert handlers()[1] is not before[1]
    second()
    assert handlers() == before


def test_a_handler_that_was_installed_later_is_kept(handlers):
    def other(number, frame):
        raise AssertionError

    release = watch(lambda: None)
    signal.signal(signal.SIGTERM, other)
    release()
    assert handlers()[1] is other


def test_ctrl_c_turns_the_led_off_and_raises_keyboard_interrupt(handlers):
    put_out = []
    signal.signal(signal.SIGINT, signal.default_int_handler)
    release = watch(lambda: put_out.append(True))
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    assert put_out == [True]
    release()
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    assert put_out == [True]


def test_sigterm_is_a_system_exit_unless_it_was_handled(handlers):
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    release = watch(lambda: None)
    with pytest.raises(SystemExit) as ended:
        signal.raise_signal(signal.SIGTERM)
    assert ended.value.code == 143
    release()
    seen = []
    signal.signal(signal.SIGTERM, lambda number, frame: seen.append(number))
    release = watch(lambda: seen.append("dark"))
    signal.raise_signal(signal.SIGTERM)
    assert seen == ["dark", signal.SIGTERM]
    release()


def test_other_threads_watch_without_handlers(handlers):
    before = handlers()
    releases = []
    thread = threading.Thread(target=lambda: releases.append(watch(lambda: None)))
    thread.start()
    thread.join()
    assert handlers() == before
    releases[0]()


def test_an_ignored_signal_is_not_watched(handlers):
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    release = watch(lambda: None)
    assert handlers()[2] is signal.SIG_IGN
    assert handlers()[1] is dark._darken_and_pass_on
    release()
    assert handlers()[2] is signal.SIG_IGN


def in_thread(call):
    failed = []

    def guarded():
        try:
            call()
        except Exception as error:  # noqa: BLE001
            failed.append(error)

    thread = threading.Thread(target=guarded)
    thread.start()
    thread.join()
    return failed


def test_handlers_stay_if_another_thread_ends_the_last_watch(handlers):
    """Only the main thread can restore them; the next watch does."""
    before = handlers()
    assert in_thread(watch(lambda: None)) == []
    assert handlers()[1] is dark._darken_and_pass_on
    watch(lambda: None)()
    assert handlers() == before


@pytest.fixture
def killed(monkeypatch):
    """Record the signals that would end this process."""
    sent = []
    monkeypatch.setattr(os, "kill", lambda pid, number: sent.append((pid, number)))
    return sent


def test_ctrl_c_with_its_default_action_ends_the_process(handlers, killed):
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    put_out = []
    release = watch(lambda: put_out.append(True))
    signal.raise_signal(signal.SIGINT)
    assert (put_out, killed) == ([True], [(os.getpid(), signal.SIGINT)])
    assert handlers()[0] is signal.SIG_DFL
    release()


def test_a_later_handler_may_pass_the_signal_on_after_the_last_watch(handlers, killed):
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    put_out = []
    release = watch(lambda: put_out.append(True))
    ours = handlers()[1]
    signal.signal(signal.SIGTERM, lambda number, frame: ours(number, frame))
    with pytest.raises(SystemExit):
        signal.raise_signal(signal.SIGTERM)
    assert (put_out, killed) == ([True], [])
    release()
    signal.raise_signal(signal.SIGTERM)
    assert (put_out, killed) == ([True], [(os.getpid(), signal.SIGTERM)])
    assert handlers()[1] is signal.SIG_DFL
