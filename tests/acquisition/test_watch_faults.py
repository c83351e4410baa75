"""Faults while a folder is watched: nothing is lost, and no image gets another light."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import DataError, Session, verify_session, watch_folder, write_png
from acquisition.imports import Watch, WatchResult, lights_in_order
from rig.host import clock, threads

pytestmark = pytest.mark.usefixtures("world")


def picture(number: int) -> np.ndarray[Any, np.dtype[np.uint16]]:
    return np.random.default_rng(number).integers(0, 65536, (8, 10)).astype(np.uint16)


def shoot(folder: Path, number: int, name: str = "") -> Path:
    path = folder / (name or f"IMG_{number:04d}.png")
    write_png(path, picture(number))
    return path


def shoot_all(folder: Path, numbers: Iterable[int]) -> None:
    for number in numbers:
        shoot(folder, number)


def watch(folder: Path, out: Path, leds: int, **options: Any) -> WatchResult:
    options = {"timeout_s": 0.5, "settle_s": 0.05, **options}
    lines = options.pop("lines", [])
    asked = Watch(folder, lights_in_order(leds), **options)
    return watch_folder(asked, out, on_message=lines.append)


def lights(out: Path) -> dict[int, int]:
    """Return the number of the picture under each LED, from the pixels of the frames."""
    assert verify_session(out).ok
    numbers = {picture(number).tobytes(): number for number in range(40)}
    frames = Session.open(out).frames
    return {f.led: numbers[f.read().tobytes()] for f in frames if f.led is not None}


def until(condition: Any, seconds: float = 20.0) -> None:
    end_s = clock.monotonic() + seconds
    while not condition():
        assert clock.monotonic() < end_s, "waited in vain"
        clock.sleep(0.02)


def test_an_image_that_arrives_in_pieces_keeps_its_light(folder: Path, out: Path) -> None:
    """The images after it are recorded meanwhile: their numbers give their lights."""
    data = shoot(folder, 1).read_bytes()
    (folder / "IMG_0001.png").write_bytes(data[:60])
    shoot_all(folder, (0, 2, 3))
    lines: list[str] = []

    def finish() -> None:
        until(lambda: (out / "frames" / "L03_E0.tif").exists())
        (folder / "IMG_0001.png").write_bytes(data[:120])
        clock.sleep(0.3)
        (folder / "IMG_0001.png").write_bytes(data)

    thread = threads.Thread(target=finish)
    thread.start()
    result = watch(folder, out, 4, timeout_s=5.0, lines=lines)
    thread.join()
    assert result.session.complete
    assert lights(out) == {0: 0, 1: 1, 2: 2, 3: 3}
    assert not any("missing by number" in line for line in lines)


def test_an_incomplete_first_image_does_not_give_its_light_to_another(
    folder: Path, out: Path
) -> None:
    data = shoot(folder, 1).read_bytes()
    (folder / "IMG_0001.png").write_bytes(data[:60])
    shoot(folder, 2)
    assert not watch(folder, out, 2).session.complete
    assert lights(out) == {1: 2}
    (folder / "IMG_0001.png").write_bytes(data)
    assert watch(folder, out, 2).session.complete
    assert lights(out) == {0: 1, 1: 2}


def test_duplicates_and_copies_shift_no_image(folder: Path, out: Path) -> None:
    shoot_all(folder, range(2))
    watch(folder, out, 3)
    shutil.copy(folder / "IMG_0001.png", folder / "IMG_0001 (1).png")
    shoot(folder, 9, "img_0001.PNG")
    lines: list[str] = []
    watch(folder, out, 3, lines=lines)
    shoot(folder, 2)
    assert watch(folder, out, 3, lines=lines).session.complete
    assert lights(out) == {0: 0, 1: 1, 2: 2}
    assert "IMG_0001 (1).png: not recorded: it is a copy of IMG_0001.png" in lines
    assert "img_0001.PNG: not recorded: its shot L01_E0 already has IMG_0001.png" in lines


def test_an_image_of_another_series_is_recorded_with_a_warning(folder: Path, out: Path) -> None:
    shoot_all(folder, range(2))
    watch(folder, out, 4)
    shoot(folder, 2, "DSC_7001.png")
    shoot(folder, 3, "DSC_7002.png")
    lines: list[str] = []
    assert watch(folder, out, 4, lines=lines).session.complete
    assert lights(out) == {0: 0, 1: 1, 2: 2, 3: 3}
    warned = [line for line in lines if "does not continue the numbers of IMG_0001.png" in line]
    assert [line.split(":")[0] for line in warned] == ["DSC_7001.png"]


def test_a_repeated_image_is_recorded_with_a_warning(folder: Path, out: Path) -> None:
    shoot(folder, 0)
    shutil.copy(folder / "IMG_0000.png", folder / "IMG_0001.png")
    shutil.copy(folder / "IMG_0000.png", folder / "top.png")
    lines: list[str] = []
    assert watch(folder, out, 3, lines=lines).session.complete
    repeated = [line.split(":")[0] for line in lines if "has the same pixels as" in line]
    assert repeated == ["IMG_0001.png", "top.png"]


def test_recorded_images_may_leave_the_folder(folder: Path, out: Path) -> None:
    shoot_all(folder, range(3))
    watch(folder, out, 6)
    for path in folder.iterdir():
        path.unlink()
    shoot(folder, 4)
    watch(folder, out, 6)
    assert lights(out) == {0: 0, 1: 1, 2: 2, 4: 4}


def test_an_image_that_was_replaced_between_two_watches_is_reported(
    folder: Path, out: Path
) -> None:
    shoot_all(folder, range(2))
    watch(folder, out, 3)
    later = time.time() + 5
    shoot(folder, 7, "IMG_0000.png")
    for name in ("IMG_0000.png", "IMG_0001.png"):  # the second was only touched
        os.utime(folder / name, (later, later))
    lines: list[str] = []
    watch(folder, out, 3, lines=lines)
    changed = [line.split(":")[0] for line in lines if "was overwritten" in line]
    assert changed == ["IMG_0000.png"]
    assert lights(out) == {0: 0, 1: 1}


def test_a_lower_number_than_the_first_ends_the_watch_and_a_new_session_is_right(
    folder: Path, out: Path
) -> None:
    shoot(folder, 2)
    watch(folder, out, 3)
    shoot(folder, 1)
    shoot(folder, 3)
    with pytest.raises(DataError, match=r"IMG_0001\.png: its number is below that of IMG_0002"):
        watch(folder, out, 3)
    assert lights(out) == {0: 2}
    again = out.parent / "again"
    assert watch(folder, again, 3).session.complete
    assert lights(again) == {0: 1, 1: 2, 2: 3}


def test_images_without_numbers_are_in_order_of_arrival(folder: Path, out: Path) -> None:
    for number, name in enumerate(("x.png", "b.png")):
        os.utime(shoot(folder, number, name), (number, number))
    watch(folder, out, 4)
    for number, name in ((2, "m.png"), (3, "a.png")):
        os.utime(shoot(folder, number, name), (number, number))
    assert watch(folder, out, 4).session.complete
    assert lights(out) == {0: 0, 1: 1, 2: 2, 3: 3}
