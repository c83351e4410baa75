"""Signals that arrive when an exception would do damage: the program ends later and cleanly."""

from __future__ import annotations

import gc
import signal
import time
import weakref
from collections.abc import Callable

import pytest

from rig import end_program, resend_signal
from rig.processes import ending as ending
from tests.quick_sample import quick

# Interrupted right after LLVM has linked modules, when the linked module has two owners.
LINKED = """
import faulthandler, gc, os, signal, sys, time
faulthandler.enable()
{taken}
import numba
from llvmlite.binding import ffi
link = ffi.lib.LLVMPY_LinkModules
def struck(*args):
    linked = link(*args)
    ffi.lib._fntab["LLVMPY_LinkModules"] = link
    os.kill(os.getpid(), signal.{name})
    time.sleep(0)
    return linked
ffi.lib._fntab["LLVMPY_LinkModules"] = struck
@numba.njit
def more(x):
    return x + 1
try:
    more(1)
    time.sleep(20)
except BaseException as error:
    # As in a program that ends later, with its compiler gone.
    del error
    gc.collect()
    print("ended", flush=True)
"""
TAKEN = "from rig import end_program\nsignal.signal(signal.{name}, end_program)"


@pytest.mark.parametrize("name", quick(["SIGINT", "SIGTERM", "SIGHUP"], every=3))
def test_a_signal_while_llvm_links_does_not_crash(name, forks):
    done = forks.run(LINKED.format(taken=TAKEN.format(name=name), name=name))
    assert "Segmentation" not in done.err
    assert (done.returncode, done.out) == (0, "ended\n")


@pytest.fixture
def taken(monkeypatch):
    """Handle SIGINT and SIGTERM with `end_program`, which looks at the program more often."""
    monkeypatch.setattr(ending, "_AGAIN_EVERY_S", 0.02)
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, end_program) for number in numbers]
    # hypothesis installs a callback in which an exception would be lost.
    callbacks, gc.callbacks[:] = gc.callbacks[:], []
    yield
    gc.callbacks[:] = callbacks
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)
    assert ending._waiting is None


def as_module(name: str, body: str) -> dict[str, object]:
    """Run code whose functions belong to a module of another name."""
    space: dict[str, object] = {"__name__": name, "signal": signal, "time": time, "after": []}
    exec(body, space)
    return space


STRIKES = """
def strikes(number):
    signal.raise_signal(number)
    after.append("continued")
"""


@pytest.mark.parametrize(
    "module", ["numba.core.codegen", "llvmlite.binding.ffi", "pydantic.main", "weakref"]
)
@pytest.mark.parametrize(
    ("number", "error"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)]
)
def test_the_exception_is_raised_after_the_module_was_left(taken, module, number, error):
    space = as_module(module, STRIKES)

    def struck() -> None:
        space["strikes"](number)
        assert space["after"] == ["continued"]
        time.sleep(5)

    with pytest.raises(error):
        struck()


def test_in_other_modules_the_exception_is_raised_at_once(taken):
    space = as_module("somewhere", STRIKES)
    with pytest.raises(KeyboardInterrupt):
        space["strikes"](signal.SIGINT)
    assert space["after"] == []


def interrupted_after(dropped: Callable[[], None], seen: list[str]) -> None:
    """Check that a function which drops an object is interrupted once the object is gone."""

    def ends() -> None:
        dropped()
        gc.collect()
        time.sleep(5)

    with pytest.raises(KeyboardInterrupt):
        ends()
    assert seen == ["continued"]


def test_a_finalizer_is_not_interrupted(taken):
    class Held:
        def __del__(self) -> None:
            signal.raise_signal(signal.SIGINT)
            seen.append("continued")

    def dropped() -> None:
        held = Held()
        del held

    seen: list[str] = []
    interrupted_after(dropped, seen)


def test_a_weak_set_that_loses_a_member_is_not_interrupted(taken):
    class Members(set):
        def discard(self, member: object) -> None:
            signal.raise_signal(signal.SIGINT)
            seen.append("continued")
            super().discard(member)

    class Held:
        pass

    def dropped() -> None:
        held = Held()
        weak = weakref.WeakSet([held])
        weak.data = Members(weak.data)
        del held

    seen: list[str] = []
    interrupted_after(dropped, seen)


def test_a_callback_of_the_garbage_collector_is_not_interrupted(taken):
    class Held:
        pass

    def strike() -> None:
        signal.raise_signal(signal.SIGINT)
        seen.append("continued")

    def dropped() -> None:
        held = Held()
        weakref.finalize(held, strike)
        del held

    seen: list[str] = []
    interrupted_after(dropped, seen)


def test_a_lost_exception_is_raised_again(taken):
    def lost() -> None:
        resend_signal(signal.SIGTERM)
        time.sleep(5)

    with pytest.raises(SystemExit) as ended:
        lost()
    assert ended.value.code == 143


def test_a_program_inside_an_import_ends_in_any_case(taken, monkeypatch):
    monkeypatch.setattr(ending, "_BRIEF_PATIENCE_S", 0.1)
    body = "def imports(number):\n    signal.raise_signal(number)\n    time.sleep(20)\n"
    with pytest.raises(KeyboardInterrupt):
        as_module("importlib._bootstrap", body)["imports"](signal.SIGINT)


def test_an_import_right_after_the_compiler_is_waited_for(taken, monkeypatch):
    """The wait for the compiler does not count: the import has just begun."""
    monkeypatch.setattr(ending, "_BRIEF_PATIENCE_S", 0.3)
    compiles = as_module(
        "numba.core",
        "def compiles(number):\n    signal.raise_signal(number)\n    time.sleep(0.4)\n",
    )["compiles"]
    # All in one import, so there is no moment in between in which the exception does no harm.
    body = "def both(number):\n compiles(number)\n time.sleep(0.1)\n after.append('imported')\n"
    space = as_module("importlib._bootstrap", body)
    space["compiles"] = compiles

    def struck() -> None:
        space["both"](signal.SIGINT)
        time.sleep(5)

    with pytest.raises(KeyboardInterrupt):
        struck()
    assert space["after"] == ["imported"]


SECOND = """
import signal, sys, time
from rig import end_program
signal.signal(signal.SIGTERM, end_program)
space = {"__name__": "numba.core", "time": time}
exec("def compiles():\\n print('compiling', flush=True)\\n while True: time.sleep(0.01)", space)
space["compiles"]()
"""


def test_a_second_signal_ends_the_process_now(forks):
    process = forks.start(SECOND)
    try:
        process.stdout.readline()
        # The first signal waits; a signal during the renewal of the wait counts as the renewal.
        for _ in range(20):
            process.send_signal(signal.SIGTERM)
            time.sleep(0.07)
            if process.poll() is not None:
                break
        assert process.wait(60) == -signal.SIGTERM
        assert process.stderr.read() == ""
    finally:
        process.end()
