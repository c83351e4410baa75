"""The examples in docstrings: every public function has one, and all of them work.

A result that is an error is compared by its kind only, since texts may change.
"""

from __future__ import annotations

import doctest
import inspect
from collections.abc import Callable, Iterator

import pytest

from tests.public_names import public_values

# Functions that do nothing useful without hardware, a file that we cannot make, or a signal.
WITHOUT = {
    "rig.end_program": "ends the program",
    "rig.open_bench": "needs a camera and a board",
    "rig.genicam.open_genicam": "needs a camera",
    "rig.genicam.open_isolated": "needs a camera",
    "rig.resend_signal": "interrupts the main thread",
}
# What these need is not there: their examples are shown, but not run.
NOT_RUN = {
    "acquisition.pixels.read_raw": "needs a camera RAW file",
    "processing.meshes.height_dataset": "needs xarray",
}
# Examples with one of these start the process of a virtual board.
_STARTS_BOARD = ("open_rig", "open_board", "simulated_rig", "VirtualBoard")
# In these rooms most examples compile kernels first.
_COMPILED = ("processing", "simulator")
# They calibrate spheres or a camera in rendered images.
_LONG = {
    "calibration.apply_spheres",
    "calibration.calibrate_moved_spheres",
    "calibration.camera.find_working_plane",
}
_FLAGS = doctest.ELLIPSIS | doctest.IGNORE_EXCEPTION_DETAIL
_FINDER = doctest.DocTestFinder(recurse=False)


FUNCTIONS = {name: value for name, value in public_values() if inspect.isfunction(value)}


def examples(function: Callable[..., object]) -> list[doctest.Example]:
    section = (inspect.getdoc(function) or "").partition("\nExamples\n--------\n")[2]
    return doctest.DocTestParser().get_examples(section)


def cases() -> Iterator[object]:
    for name, function in FUNCTIONS.items():
        code = "".join(example.source for example in examples(function))
        compiled = name.startswith(_COMPILED)
        long = compiled or name in _LONG or any(word in code for word in _STARTS_BOARD)
        slow = pytest.mark.slow if long else ()
        if code and name not in NOT_RUN:
            yield pytest.param(function, id=name, marks=slow)


@pytest.mark.parametrize("function", list(cases()))
def test_the_example_works(function, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    (test,) = _FINDER.find(function, function.__name__, globs={})
    failed, tried = doctest.DocTestRunner(optionflags=_FLAGS).run(test, clear_globs=True)
    assert tried
    assert not failed, capsys.readouterr().out


def test_every_public_function_has_an_example() -> None:
    without = {name for name, function in FUNCTIONS.items() if not examples(function)}
    assert without == set(WITHOUT)


def test_only_examples_that_cannot_run_are_not_run() -> None:
    skipped = {
        name
        for name, function in FUNCTIONS.items()
        if any(doctest.SKIP in example.options for example in examples(function))
    }
    assert skipped == set(NOT_RUN)


def test_examples_are_short() -> None:
    """Imports aside, about 3 to 8 lines."""
    lines = {
        name: sum(
            line.startswith((">>> ", "... ")) and not line.startswith((">>> import ", ">>> from "))
            for line in (inspect.getdoc(function) or "").splitlines()
        )
        for name, function in FUNCTIONS.items()
    }
    assert {name: count for name, count in lines.items() if count > 9} == {}
