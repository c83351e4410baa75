"""Networks of another origin run in a separate process first, which may end in any way."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from acquisition import DataError
from processing.superres import network_trial as trial
from processing.superres import read_superres_model
from processing.superres.network import Network

FOREIGN = replace(read_superres_model(None, 2), path=Path("given.onnx"), sha256="0" * 64)


@pytest.mark.parametrize(
    ("child", "said"),
    [
        pytest.param("import os; os.abort()", "OpenCV crashed with it", id="abort"),
        pytest.param("1 / 0", "OpenCV crashed with it", id="error without a reason"),
        pytest.param("import time; time.sleep(9)", "took longer than 0.5 s", id="hangs"),
        pytest.param("print('given.onnx: odd', end=''); exit(1)", "odd", id="refused"),
    ],
)
def test_the_end_of_the_process_is_an_error_of_the_file(
    child: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trial, "_LIMIT_S", 0.5 if "sleep" in child else 60)
    monkeypatch.setattr(trial, "module_command", lambda module: [sys.executable, "-c", child])
    with pytest.raises(DataError, match=f"^given.onnx: .*{said}"):
        Network(FOREIGN)


def test_a_network_of_another_origin_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    Network(FOREIGN)
    with pytest.raises(DataError, match=r"^given\.onnx: .*OpenCV cannot load it"):
        Network(replace(FOREIGN, data=FOREIGN.data[:1000]))


def test_a_network_that_comes_with_the_program_starts_no_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(trial, "module_command", lambda module: pytest.fail("started"))
    Network(read_superres_model(None, 2))
