"""Tethered capture from a folder that is filled while it is watched."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import (
    CapturePlan,
    DataError,
    Labels,
    Lights,
    MissingPathError,
    Session,
    StorageError,
    verify_session,
    watch_folder,
    write_exr,
    write_png,
)
from acquisition.imports import Watch, WatchResult, lights_in_order
from acquisition.imports import watch_files as _watch_files
from acquisition.pixels import write_tiff
from acquisition.session import Manifest, SessionWriter
from rig.arrays import UInt16
from rig.host import clock, threads

pytestmark = pytest.mark.usefixtures("world")

SHAPE = (8, 10)
BEGIN_NS = 1_700_000_000 * 10**9


def picture(number: int) -> UInt16:
    return np.random.default_rng(number).integers(0, 65536, SHAPE).astype(np.uint16)


def shoot(folder: Path, number: int, time_s: float, name: str | None = None) -> Path:
    """Write an image as if it were written ``time_s`` seconds after the first."""
    path = folder / (name or f"IMG_{number:04d}.png")
    write_png(path, picture(number))
    stamp = BEGIN_NS + round(time_s * 1e9)
    os.utime(path, ns=(stamp, stamp))
    return path


def shoot_all(folder: Path, numbers: Iterable[int]) -> None:
    """Write images at an even pace of 2 s."""
    for number in numbers:
        shoot(folder, number, 2.0 * number)


def watch(folder: Path, leds: int = 8, **options: Any) -> Watch:
    options = {"timeout_s": 0.6, "settle_s": 0.05, **options}
    return Watch(folder, lights_in_order(leds), **options)


def recorded(out: Path) -> dict[int, str | None]:
    """Return the origin of each frame by LED, and check the pixels."""
    session = Session.open(out)
    for frame in session.frames:
        assert frame.line.origin is not None
        number = re.search(r"\d+", frame.line.origin)
        assert number is not None
        np.testing.assert_array_equal(frame.read(), picture(int(number[0])))
    return {frame.led: frame.line.origin for frame in session.frames if frame.led is not None}


def test_images_that_are_there_become_a_complete_session(folder: Path, out: Path) -> None:
    shoot_all(folder, range(8))
    (folder / ".hidden.png").write_bytes(b"x")
    (folder / "notes.txt").write_text("x")
    lines: list[str] = []
    steps: list[tuple[str, int, int]] = []
    lights = Lights(directions=np.stack([np.arange(8), np.zeros(8), np.ones(8)], 1))
    result = watch_folder(
        watch(folder),
        out,
        lights=lights,
        on_message=lines.append,
        on_progress=lambda *report: steps.append(report),
        labels=Labels(operator="Ada", place="Rome"),
    )
    assert result.missing == ()
    assert result.session.complete
    assert verify_session(out).ok
    assert recorded(out) == {i: f"IMG_{i:04d}.png" for i in range(8)}
    assert lines[0] == "IMG_0000.png is L00_E0"
    assert steps == [("watching", i + 1, 8) for i in range(8)]
    assert result.session.manifest.place == "Rome"
    assert result.session.lights is not None
    assert result.session.lights.ids == lights.ids


def test_a_missing_number_leaves_a_shot_empty_and_is_reported(folder: Path, out: Path) -> None:
    shoot_all(folder, (0, 1, 2, 4, 5, 6, 7))
    result = watch_folder(watch(folder), out)
    assert [shot.file for shot in result.missing] == ["L03_E0.tif"]
    assert not result.session.complete
    assert recorded(out)[4] == "IMG_0004.png"
    assert any(
        "1 image is missing by number between IMG_0002.png and IMG_0004" in w
        for w in map(str, result.warnings)
    )
    assert any("save an image as L03_E0.png" in w for w in map(str, result.warnings))
    # An image with the name of the missing shot fills it; no other image changes its shot.
    shoot(folder, 3, 99, "L03_E0.png")
    again = watch_folder(watch(folder), out)
    assert again.session.complete
    assert recorded(out)[3] == "L03_E0.png"
    assert recorded(out)[4] == "IMG_0004.png"
    assert verify_session(out).ok


def test_a_gap_in_time_counts_if_the_interval_is_stated(folder: Path, out: Path) -> None:
    for number, at in enumerate([0, 2, 4, 8, 10, 12, 14]):
        shoot(folder, number, at)
    result = watch_folder(watch(folder, interval_s=2.0), out)
    assert [shot.file for shot in result.missing] == ["L03_E0.tif"]
    assert recorded(out)[4] == "IMG_0003.png"


def test_an_image_after_a_gap_waits_for_the_next_in_case_it_was_only_delayed(
    folder: Path, out: Path
) -> None:
    for number in range(6):
        shoot(folder, number, float(number))
    shoot(folder, 6, 7.1)  # as late as if one were missing
    lines: list[str] = []

    def tell(line: str) -> None:
        lines.append(line)
        if line == "IMG_0005.png is L05_E0":
            shoot(folder, 7, 7.3)

    result = watch_folder(watch(folder, timeout_s=5.0, interval_s=1.0), out, on_message=tell)
    assert result.session.complete
    assert recorded(out) == {i: f"IMG_{i:04d}.png" for i in range(8)}
    assert not any("missing" in line for line in lines)


def test_an_image_after_a_gap_does_not_wait_for_ever(folder: Path, out: Path) -> None:
    for number in range(6):
        shoot(folder, number, 0.6 * number)
    shoot(folder, 6, 0.6 * 7)
    began_s = clock.monotonic()
    reported_s: dict[str, float] = {}
    result = watch_folder(
        watch(folder, timeout_s=3.0, interval_s=0.6),
        out,
        on_message=lambda line: reported_s.setdefault(line, clock.monotonic() - began_s),
    )
    assert [shot.file for shot in result.missing] == ["L06_E0.tif"]
    assert 1.2 <= reported_s["IMG_0006.png is L07_E0"] < 2.5


def test_an_overwritten_image_is_reported_and_shifts_no_other(folder: Path, out: Path) -> None:
    shoot_all(folder, range(6))

    def tell(line: str) -> None:
        lines.append(line)
        if line == "IMG_0005.png is L05_E0":
            write_png(folder / "IMG_0002.png", picture(99))  # with the current time
            shoot(folder, 7, 14.0)

    lines: list[str] = []
    result = watch_folder(watch(folder), out, on_message=tell)
    assert recorded(out) == {i: f"IMG_{i:04d}.png" for i in (0, 1, 2, 3, 4, 5, 7)}
    assert [shot.file for shot in result.missing] == ["L06_E0.tif"]
    line = (
        "IMG_0002.png: was overwritten after it was recorded; the session holds the earlier image"
    )
    assert lines.count(line) == 1


def test_without_gaps_missing_numbers_are_ignored(folder: Path, out: Path) -> None:
    shoot_all(folder, (0, 1, 5, 6, 7, 8, 9, 20))
    assert watch_folder(watch(folder, gaps=False), out).session.complete


def test_more_images_than_lights_are_named(folder: Path, out: Path) -> None:
    shoot_all(folder, range(7))
    result = watch_folder(watch(folder, leds=6), out)
    assert result.session.complete
    assert any("IMG_0006.png: no shot is left" in line for line in map(str, result.warnings))


def in_background(work: Callable[[], None]) -> threads.Thread:
    thread = threads.Thread(target=work, daemon=True)
    thread.start()
    return thread


def test_images_are_recorded_as_they_appear_and_only_when_complete(folder: Path, out: Path) -> None:
    """Files grow slowly under their final name, stall midway, or are renamed when complete."""
    (folder.parent / "ready").mkdir()

    def camera() -> None:
        for number in range(8):
            source = shoot(folder.parent / "ready", number, 2.0 * number)
            data, status = source.read_bytes(), source.stat()
            path = folder / source.name
            if number % 3 == 2:
                os.replace(source, path)
                continue
            with path.open("wb") as file:
                for start in range(0, len(data), len(data) // 3 + 1):
                    file.write(data[start : start + len(data) // 3 + 1])
                    file.flush()
                    # Longer than a file must stay unchanged to count as complete.
                    clock.sleep(0.12)
            os.utime(path, ns=(status.st_mtime_ns, status.st_mtime_ns))

    thread = in_background(camera)
    lines: list[str] = []
    result = watch_folder(watch(folder, timeout_s=20.0), out, on_message=lines.append)
    thread.join(20)
    assert result.session.complete
    assert recorded(out) == {i: f"IMG_{i:04d}.png" for i in range(8)}


def test_by_order_no_later_image_is_recorded_before_an_incomplete_file(
    folder: Path, out: Path
) -> None:
    shoot_all(folder, range(8))
    cut = folder / "IMG_0003.png"
    data, status = cut.read_bytes(), cut.stat()
    cut.write_bytes(data[:-20])
    result = watch_folder(watch(folder, gaps=False), out)
    assert sorted(recorded(out)) == [0, 1, 2]
    assert any(
        "waiting for the rest" in w and "IMG_0003.png" in w for w in map(str, result.warnings)
    )
    cut.write_bytes(data)
    os.utime(cut, ns=(status.st_mtime_ns, status.st_mtime_ns))
    assert watch_folder(watch(folder, gaps=False), out).session.complete
    assert verify_session(out).ok


def test_an_interrupted_watch_continues_where_it_stopped(folder: Path, out: Path) -> None:
    for number, at in enumerate([0, 2, 4, 6, 100]):
        shoot(folder, number, at)

    def interrupted(stage: str, done: int, total: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        watch_folder(watch(folder), out, on_progress=interrupted)
    assert verify_session(out).ok
    assert sorted(recorded(out)) == [0, 1, 2]
    for number, at in ((5, 1000), (6, 1014), (7, 9999)):
        shoot(folder, number, at)
    lines: list[str] = []
    result = watch_folder(watch(folder), out, on_message=lines.append)
    assert "continued with 3 images" in lines[0]
    assert result.session.complete
    assert recorded(out) == {i: f"IMG_{i:04d}.png" for i in range(8)}


def test_a_session_for_other_shots_is_not_continued(folder: Path, out: Path) -> None:
    shoot(folder, 0, 0)
    watch_folder(watch(folder), out)
    with pytest.raises(DataError, match="the same LEDs or the same plan"):
        watch_folder(watch(folder, leds=9), out)
    assert verify_session(out).ok


def test_a_watch_killed_before_its_first_frame_is_continued(folder: Path, out: Path) -> None:
    shoot_all(folder, range(3))
    camera = {"width": SHAPE[1], "height": SHAPE[0], "bit_depth": 16}
    manifest = Manifest.begin(out, camera=camera)
    SessionWriter.create(out, manifest).close()
    assert watch_folder(watch(folder, leds=3), out).session.complete
    assert verify_session(out).ok
    assert recorded(out)[2] == "IMG_0002.png"


def test_two_watchers_of_one_session(folder: Path, out: Path) -> None:
    shoot(folder, 0, 0)
    watch_folder(watch(folder), out)
    writer = SessionWriter.reopen(out)
    try:
        with pytest.raises(StorageError, match="another process"):
            watch_folder(watch(folder), out)
    finally:
        writer.close()


def test_images_that_another_watcher_recorded_meanwhile_are_not_recorded_again(
    folder: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other watcher records after the session was read and before it is locked."""
    shoot(folder, 0, 0)
    watch_folder(watch(folder, leds=3), out)
    shoot(folder, 1, 2)
    real = SessionWriter.reopen

    def reopened_late(path: Path) -> SessionWriter:
        monkeypatch.setattr(SessionWriter, "reopen", real)
        watch_folder(watch(folder, leds=3), out)
        return real(path)

    monkeypatch.setattr(SessionWriter, "reopen", reopened_late)
    watch_folder(watch(folder, leds=3), out)
    assert [frame.line.origin for frame in Session.open(out).recorded] == [
        "IMG_0000.png",
        "IMG_0001.png",
    ]


def test_a_plan_gives_the_shots_and_is_kept(folder: Path, out: Path) -> None:
    plan = CapturePlan(repeat=False, leds=(3, 1), exposures_us=(1000.0, 4000.0), dark=True)
    shots = plan.shots()
    shoot_all(folder, range(len(shots)))
    result: WatchResult = watch_folder(
        Watch(folder, shots, plan, timeout_s=0.6, settle_s=0.05), out
    )
    assert result.session.complete
    assert result.session.manifest.plan == plan
    assert [frame.line.origin for frame in result.session.frames] == [
        f"IMG_{i:04d}.png" for i in range(6)
    ]
    assert [frame.role for frame in result.session.frames][:2] == ["dark", "dark"]
    assert [frame.led for frame in result.session.frames][2:] == [3, 1, 3, 1]


def test_a_watch_without_any_image_is_an_error_and_leaves_no_session(
    folder: Path, out: Path
) -> None:
    with pytest.raises(DataError, match=r"in: no image appeared within 0\.3 s"):
        watch_folder(watch(folder, timeout_s=0.3), out)
    assert not out.exists()
    (folder / "a.png").write_bytes(b"no image")
    with pytest.raises(DataError, match=r"a\.png: .*no image appeared"):
        watch_folder(watch(folder, timeout_s=0.3), out)
    with pytest.raises(MissingPathError, match="no such folder"):
        watch_folder(watch(folder / "none"), out)


def test_an_image_of_another_kind_is_refused_and_the_session_stays_intact(
    folder: Path, out: Path
) -> None:
    shoot_all(folder, range(3))
    write_tiff(folder / "IMG_0003.tif", np.zeros((4, 4), np.uint16))
    with pytest.raises(DataError, match=r"IMG_0003\.tif: 4 x 4 grey uint16, but"):
        watch_folder(watch(folder, gaps=False), out)
    assert sorted(recorded(out)) == [0, 1, 2]
    # When the session is continued, images are still compared with the first one.
    with pytest.raises(DataError, match=r"IMG_0003\.tif: 4 x 4 grey uint16, but"):
        watch_folder(watch(folder, gaps=False), out)
    assert verify_session(out).ok


def test_float_images_are_refused(folder: Path, out: Path) -> None:
    write_exr(folder / "a.exr", np.ones((4, 4), np.float32))
    with pytest.raises(DataError, match=r"a\.exr: a session holds whole numbers"):
        watch_folder(watch(folder, timeout_s=0.3), out)


def test_a_full_disk_keeps_the_recorded_frames(
    folder: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shoot_all(folder, range(8))
    real = os.replace

    def full(*arguments: Any) -> None:
        if len(list(out.glob("frames/L*"))) == 3:
            raise OSError(28, "No space left on device")
        real(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", full)
        with pytest.raises(StorageError, match="No space left"):
            watch_folder(watch(folder), out)
    assert verify_session(out).ok
    assert len(recorded(out)) == 3
    assert watch_folder(watch(folder), out).session.complete
    assert verify_session(out).ok


def test_few_images_are_kept_in_memory_while_they_wait(
    folder: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shoot_all(folder, range(6))
    read: list[str] = []
    real = _watch_files.read_for_import

    def counted(path: Path, **options: Any) -> Any:
        read.append(path.name)
        return real(path, **options)

    monkeypatch.setattr(_watch_files, "read_for_import", counted)
    assert watch_folder(watch(folder, leds=6), out).session.complete
    assert len(read) == 6 + (6 - _watch_files._KEPT)
