"""Workers that need a kernel wait for the one that compiles it."""

import sys
import threading
from types import SimpleNamespace

import pytest

from tests.compile_once import alone, one_by_one


def kernel(cache_path):
    return SimpleNamespace(py_func=kernel, stats=SimpleNamespace(cache_path=cache_path))


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no flock")
def test_a_worker_waits_for_the_one_that_compiles(tmp_path):
    compiled = []
    compiler = one_by_one(lambda _, signature: compiled.append(signature), tmp_path)
    # A file that is locked twice in one process waits like one that two processes lock.
    with alone(tmp_path / f"{__name__}.kernel"):
        waiting = threading.Thread(target=compiler, args=(kernel("a folder"), "once"))
        waiting.start()
        waiting.join(0.1)
        assert waiting.is_alive()
        assert compiled == []
    waiting.join(10)
    assert compiled == ["once"]


def test_a_kernel_that_is_compiled_while_it_is_compiled_does_not_wait(tmp_path):
    def compiler(_, depth):
        return again(kernel("a folder"), depth - 1) if depth else "compiled"

    again = one_by_one(compiler, tmp_path)
    assert again(kernel("a folder"), 3) == "compiled"
    assert again(kernel("a folder"), 0) == "compiled", "the first has ended"


def test_functions_of_numba_do_not_wait(tmp_path):
    compiler = one_by_one(lambda *_: "compiled", tmp_path)
    with alone(tmp_path / f"{__name__}.kernel"):
        assert compiler(kernel(None), "here") == "compiled"
