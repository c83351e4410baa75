"""Progress of the stages of a run."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import processing
from sgp.app import build, run
from sgp.cli import console as _console
from sgp.cli.console import Stages, shown
from sgp.pictures import Panel, write_overview
from sgp.stages import RunOptions, Stopwatch, open_source, processed


def dome(size: int = 48) -> processing.NormalMap:
    y, x = np.mgrid[:size, :size] / size - 0.5
    normals = np.dstack([x, -y, np.ones_like(x)])
    return processing.NormalMap.from_vectors(normals, np.ones((size, size), bool))


def test_integration_reports_percent_of_the_digits_that_it_gains() -> None:
    steps: list[tuple[str, int, int]] = []
    processing.integrate(dome(), on_progress=lambda *report: steps.append(report))
    done = [step[1] for step in steps]
    assert {step[0] for step in steps} == {"integrating"}
    assert {step[2] for step in steps} == {100}
    assert done == sorted(done)
    assert (done[0], done[-1]) == (0, 100)
    assert len(set(done)) > 3


@pytest.mark.parametrize(
    ("stage", "steps", "call"),
    [
        ("detail", 9, lambda report: processing.separate(dome(), on_progress=report)),
        (
            "detail",
            2,
            lambda report: processing.separate(
                dome(), shape_filter=processing.ShapeFilter("guided"), on_progress=report
            ),
        ),
        (
            "transferring",
            5,
            lambda report: processing.transfer_local(
                dome(), dome(), target_mask=dome().normals[..., 0] > 0, on_progress=report
            ),
        ),
        (
            "projecting",
            5,
            lambda report: processing.project(
                processing.Geometry(np.eye(3), np.array([[0, 1, 2]])),
                pixel_mm=0.1,
                on_progress=report,
            ),
        ),
    ],
    ids=["filter", "guided filter", "local transfer", "projection"],
)
def test_long_functions_report_every_step_once(stage, steps, call) -> None:
    reported: list[tuple[str, int, int]] = []
    call(lambda *report: reported.append(report))
    assert reported == [(stage, done, steps) for done in range(steps + 1)]


def test_points_report_fits_and_drawing() -> None:
    reported: list[tuple[str, int, int]] = []
    y, x = np.mgrid[:9, :9] / 9
    cloud = processing.Geometry(np.stack([x, y, 0.1 * x * y], -1).reshape(-1, 3))
    processing.project(cloud, pixel_mm=0.1, on_progress=lambda *report: reported.append(report))
    assert reported == [
        ("fitting normals", 0, 81),
        ("fitting normals", 81, 81),
        ("drawing points", 0, 1),
        ("drawing points", 1, 1),
    ]


def test_filled_holes_are_reported_in_pixels() -> None:
    holes = np.zeros((48, 48), bool)
    holes[8:11, 8:11] = holes[30:34, 38:42] = True
    reported: list[tuple[str, int, int]] = []
    processing.fill_holes(
        dome(), holes, patch=8, on_progress=lambda *report: reported.append(report)
    )
    assert reported == [("filling", 0, 25), ("filling", 9, 25), ("filling", 25, 25)]


def stages_of(monkeypatch, call) -> dict[str, tuple[int, int]]:
    """Return the last report of each stage that is shown while a function runs."""
    last: dict[str, tuple[int, int]] = {}

    class Shown:
        def __init__(self, what: str) -> None:
            self.what = what
            last.pop(what, None)

        def __call__(self, done: int, total: int) -> None:
            assert 0 <= done <= total
            assert (done, total) >= last.get(self.what, (0, total))
            last[self.what] = done, total

    monkeypatch.setattr(_console, "_Lines", Shown)
    call()
    return last


@pytest.mark.parametrize(("before", "left"), [(0, "about 10 s left"), (10, "about 80 s left")])
def test_continued_work_does_not_count_what_was_done_before(
    before, left, monkeypatch, capsys
) -> None:
    now = iter([0.0, 0.0, 40.0])
    monkeypatch.setattr(_console, "time", SimpleNamespace(monotonic=lambda: next(now)))
    show = _console._Lines("training")
    show(before, 25)
    show(20 if before == 0 else 15, 25)
    assert left in capsys.readouterr().err


def test_every_stage_of_a_run_is_shown_to_its_end(recording: Path, tmp_path, monkeypatch) -> None:
    source, files = open_source(recording, lights=recording.parent / "lights.json")

    def call() -> None:
        with processed(source, files, tmp_path / "out", Stopwatch(), RunOptions()):
            pass
        write_overview(tmp_path / "a.png", "", [Panel("a", lambda axes: axes.plot([0, 1]))] * 3)

    stages = stages_of(monkeypatch, call)
    expected = ["reading", "normals", "writing normals", "writing maps",
                "hashing the inputs", "hashing the result", "detail", "writing shape",
                "writing detail", "integrating", "writing meshes",
                "drawing"]  # fmt: skip
    assert set(stages) == set(expected)
    assert all(done == total for done, total in stages.values()), stages


def test_a_transfer_is_shown_to_its_end(tmp_path, monkeypatch) -> None:
    processing.write_normals(tmp_path / "map", dome())
    place = str(tmp_path / "map")
    words = ["detail", "transfer", place, place, "--out", str(tmp_path / "out")]
    stages = stages_of(monkeypatch, lambda: run(build(words), words))
    done, total = stages["transferring"]
    assert done == total > 7


def test_one_bar_is_shown_at_a_time(monkeypatch) -> None:
    """A terminal has room for one; the stage of a caller stays while others run inside it."""

    def call() -> None:
        with Stages() as outer:
            outer("outer", 1, 2)
            assert list(shown("inner", "ab")) == ["a", "b"]
            outer("outer", 2, 2)
        assert list(shown("after", "c")) == ["c"]

    assert stages_of(monkeypatch, call) == {"outer": (2, 2), "after": (1, 1)}
