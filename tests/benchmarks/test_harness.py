"""The harness of the benchmarks leaves its caller as it was."""

from __future__ import annotations

import os

from benchmarks.harness import alone


def test_a_process_of_its_own_has_an_environment_of_its_own(monkeypatch) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    before = dict(os.environ)
    assert alone(os.getenv, "OPENBLAS_NUM_THREADS") == "1"
    assert dict(os.environ) == before
