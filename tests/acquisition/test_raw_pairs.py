"""Cameras that store each exposure as camera RAW and as JPEG."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from acquisition import Session, import_frames, read_source, watch_folder
from acquisition.imports import Watch, WatchResult, lights_in_order, read_import
from rig import Notice
from rig.host import clock, threads
from tests.acquisition.dng_file import dng
from tests.quick_sample import quick

pytestmark = pytest.mark.usefixtures("world")
SENSOR = np.random.default_rng(3).integers(64, 4000, (40, 60)).astype(np.uint16)


def save(folder: Path, name: str) -> None:
    number, suffix = int(Path(name).stem[-1]), Path(name).suffix
    if suffix == ".dng":
        (folder / name).write_bytes(dng(SENSOR + number))
    else:
        picture = np.random.default_rng(number).integers(0, 255, (20, 30, 3)).astype(np.uint8)
        (folder / name).write_bytes(cv2.imencode(".jpg", picture)[1].tobytes())


def watched(
    folder: Path, names: Sequence[str], pair_s: float = 5.0, leds: int = 3, timeout_s: float = 1.0
) -> WatchResult:
    """Watch a folder in which files appear one after another."""

    def deliver() -> None:
        for name in names:
            save(folder, name)
            clock.sleep(0.25)

    camera = threads.Thread(target=deliver)
    camera.start()
    watch = Watch(folder, lights_in_order(leds), timeout_s=timeout_s, settle_s=0.02, pair_s=pair_s)
    result = watch_folder(watch, folder.parent / "out")
    camera.join()
    return result


def origins(session: Session) -> dict[int | None, str | None]:
    for frame in session.frames:
        name = str(frame.line.origin)
        if name.endswith("dng"):
            np.testing.assert_array_equal(frame.read(), SENSOR + int(Path(name).stem[-1]))
    return {frame.led: frame.line.origin for frame in session.frames}


def codes(notices: Sequence[Notice]) -> list[str]:
    return [notice.code for notice in notices]


RAW = {i: f"IMG_{i}.dng" for i in range(3)}


@pytest.mark.parametrize(
    "names",
    quick(
        [
            pytest.param(
                ["IMG_0.JPG", "IMG_0.dng", "IMG_1.JPG", "IMG_1.dng", "IMG_2.JPG", "IMG_2.dng"],
                id="JPEG first",
            ),
            pytest.param(
                ["IMG_0.dng", "IMG_0.JPG", "IMG_1.dng", "IMG_1.JPG", "IMG_2.dng"], id="RAW first"
            ),
            pytest.param(
                ["IMG_0.JPG", "IMG_1.JPG", "IMG_0.dng", "IMG_1.dng", "IMG_2.dng"],
                id="RAW far behind",
            ),
        ],
        every=3,
    ),
)
def test_the_raw_file_of_a_pair_is_recorded_in_any_order(folder: Path, names: list[str]) -> None:
    result = watched(folder, names)
    assert result.session.complete
    assert origins(result.session) == RAW
    assert codes(result.warnings).count("raw-preferred") == 1


def test_jpegs_alone_are_recorded_after_a_while(folder: Path) -> None:
    result = watched(folder, ["IMG_0.jpg", "IMG_1.jpg", "IMG_2.jpg"], pair_s=0.4)
    assert origins(result.session) == {i: f"IMG_{i}.jpg" for i in range(3)}
    assert "raw-awaited" in codes(result.warnings)


def test_a_watch_that_ends_while_jpegs_wait_records_them(folder: Path) -> None:
    result = watched(folder, ["IMG_0.jpg"], pair_s=60.0, timeout_s=0.4)
    assert origins(result.session) == {0: "IMG_0.jpg"}


def test_raw_files_that_come_too_late_change_nothing(folder: Path) -> None:
    watched(folder, ["IMG_0.jpg", "IMG_1.jpg"], pair_s=0.0, timeout_s=0.5)
    for name in ("IMG_0.dng", "IMG_1.dng", "IMG_2.dng"):
        save(folder, name)
    result = watched(folder, ["IMG_2.jpg"])
    assert origins(result.session) == {i: f"IMG_{i}.jpg" for i in range(3)}
    assert codes(result.warnings).count("raw-too-late") == 1


def test_an_interrupted_watch_of_pairs_continues(folder: Path) -> None:
    watched(folder, ["IMG_0.JPG", "IMG_0.dng", "IMG_1.JPG"], timeout_s=0.5)
    result = watched(folder, ["IMG_1.dng", "IMG_2.JPG", "IMG_2.dng"])
    assert origins(result.session) == RAW


def test_a_folder_of_pairs_is_imported_as_raw(folder: Path, tmp_path: Path) -> None:
    for i in range(3):
        save(folder, f"IMG_{i}.dng")
        save(folder, f"img_{i}.JPG")
    source = read_import(folder)
    assert [frame.path.name for frame in source.frames] == list(RAW.values())
    assert codes(source.warnings) == ["raw-preferred"]
    assert "the 3 other images are not" in str(source.warnings[0])
    assert source.ignored == ()
    assert origins(import_frames(source, tmp_path / "out")) == RAW


@pytest.mark.parametrize(("suffix", "raw"), [("", True), (".dng", True), (".JPG", False)])
def test_an_lp_file_may_choose_the_jpegs(folder: Path, suffix: str, raw: bool) -> None:
    for i in range(3):
        save(folder, f"IMG_{i}.dng")
        save(folder, f"IMG_{i}.JPG")
    lines = [f"IMG_{i}{suffix} 0 0 1" for i in range(3)]
    (folder / "lights.lp").write_text("\n".join(["3", *lines]))
    source = read_source(folder)
    assert [frame.path.suffix for frame in source.frames] == [".dng" if raw else ".JPG"] * 3
    assert ("raw-preferred" in codes(source.warnings)) == raw
