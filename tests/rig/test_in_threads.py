"""Kernels are called for ranges that cover all iterations once, in several threads."""

from __future__ import annotations

import threading

import numba
import numpy as np
import pytest

from rig import in_threads


@pytest.fixture
def four_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba, "get_num_threads", lambda: 4)


@pytest.mark.usefixtures("four_threads")
def test_every_iteration_is_done_once() -> None:
    def kernel(first: int, last: int, out: np.ndarray) -> None:
        assert 0 <= first <= last <= len(out)
        out[first:last] += 1

    for count in range(101):
        done = np.zeros(count, int)
        in_threads(kernel, count, done)
        assert (done == 1).all()


@pytest.mark.usefixtures("four_threads")
def test_ranges_are_shared_between_threads() -> None:
    together = threading.Barrier(4, timeout=60)

    def kernel(first: int, last: int) -> None:
        if first < last:
            together.wait()  # returns if four threads are here at the same time

    in_threads(kernel, 16)


def test_one_thread_is_the_thread_of_the_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba, "get_num_threads", lambda: 1)
    calls = []
    in_threads(lambda *given: calls.append((threading.get_ident(), *given)), 7, "a")
    assert calls == [(threading.get_ident(), 0, 7, "a")]


@pytest.mark.usefixtures("four_threads")
def test_the_kernel_is_compiled_in_the_thread_of_the_caller() -> None:
    calls = []
    in_threads(lambda *given: calls.append((threading.get_ident(), *given)), 7)
    assert calls[0] == (threading.get_ident(), 0, 0)
    assert threading.get_ident() not in {ident for ident, *_ in calls[1:]}


@pytest.mark.usefixtures("four_threads")
def test_an_error_of_a_kernel_is_raised() -> None:
    def kernel(first: int, last: int) -> None:
        if first <= 5 < last:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        in_threads(kernel, 9)
