"""Running numbers of names: the order of images, and lights that are matched by number."""

from __future__ import annotations

import unicodedata
from pathlib import Path

import numpy as np
import pytest

from acquisition import DataError, Lights, exclude, import_frames, read_source, write_png
from acquisition.source.image_folder import numbered_series
from acquisition.values.running_numbers import order_doubt, running_number, steps_between
from tests.cases import cases


def names(form: str, *numbers: int) -> list[str]:
    return [f"{form % number}.png" for number in numbers]


def fill(folder: Path, files: list[str]) -> Path:
    for value, name in enumerate(files):
        write_png(folder / name, np.full((4, 6), 100 * value + 100, np.uint16))
    return folder


@cases(
    "files",
    {
        "from 1": names("IMG_%04d", 9998, 9999, 1, 2),
        "from 0": names("IMG_%04d", 9998, 9999, 0, 1),
        "numbers missing at the restart": names("IMG_%04d", 9996, 9999, 3, 5),
        "four of five digits": names("DSC%05d", 9998, 9999, 1),
        "six digits": names("f%06d", 999998, 999999, 0),
        "three digits": names("f%03d", 998, 999, 0),
        "16 bits": names("f_%d", 65534, 65535, 0, 1),
        "no restart": names("IMG_%d", 9998, 9999, 10000),
        "rings": names("v%03d", 1, 2, 3, 101, 102, 103, 201, 202),
        "evenly over the counter": names("a%04d", *range(0, 10_000, 500)),
        "one digit": names("a.%d", 1, 2, 9),
        "half of a dome": names("L%02d", *range(18), *range(82, 100)),
        "midnight": ["a_20240501_235958.png", "a_20240501_235959.png", "a_20240502_000001.png"],
        "clock and number": [f"cam1_20240501_12300{i}_{i + 7}.png" for i in range(5)],
    },
)
def test_the_order_of_images_in_a_folder(tmp_path: Path, files: list[str]) -> None:
    for name in files:
        (tmp_path / name).touch()
    assert [path.name for path in numbered_series(sorted(tmp_path.iterdir()))] == files
    assert order_doubt(files) == ""


@cases(
    ("low", "high"),
    {
        "far from the restart": ([401, 402], [9200, 9201]),
        "sparse": ([1, 11, 21], [9970, 9980, 9990]),
    },
)
def test_an_order_that_cannot_be_known_is_refused_only_if_it_matters(
    tmp_path: Path, low: list[int], high: list[int]
) -> None:
    files = names("IMG_%04d", *low, *high)
    folder = fill(tmp_path, files)
    directions = np.column_stack([np.arange(len(files)), np.ones(len(files)), np.ones(len(files))])
    with pytest.raises(DataError, match=rf"IMG_{low[0]:04d} to .* before or after IMG_{high[0]}"):
        read_source(folder, lights=Lights(directions))
    with pytest.raises(DataError, match="before or after"):
        import_frames(read_source(folder), tmp_path / "session")
    named = read_source(folder, lights=Lights(directions, ids=tuple(files)))
    assert import_frames(named, tmp_path / "session").complete


def test_a_restart_is_noted_once_and_kept_by_import_and_ranges(tmp_path: Path) -> None:
    files = names("DSC_%04d", 9997, 9998, 9999, 1, 2)
    folder = fill(tmp_path, files)
    source = read_source(folder, lights=Lights(np.eye(5)[:, :3] + [0, 0, 1]))
    assert [notice.code for notice in source.warnings] == [
        "counter-restarted",
        "lights-matched-by-order",
    ]
    session = import_frames(source, tmp_path / "session")
    assert {frame.line.origin: frame.led for frame in session.frames} == {
        name: led for led, name in enumerate(files)
    }
    assert exclude(source, ["9998-1"]).light_ids == ("DSC_9997", "DSC_0002")
    (notice,) = exclude(source, ["2-7"]).warnings[2:]
    assert notice.text == "2-7 leaves out 1 image: the images have the numbers 9997 to 2"
    with pytest.raises(DataError, match="no image is named '0'"):
        exclude(source, ["0"])


@pytest.mark.parametrize(
    ("earlier", "later", "steps"),
    [
        ("IMG_9999", "IMG_0001", 1),
        ("IMG_9999", "IMG_0000", 1),
        ("IMG_0002", "IMG_9998", -3),
        ("DSC09999", "DSC00003", 3),
        ("IMG_0850", "IMG_0001", -849),
        ("a.9", "a.1", -8),
    ],
)
def test_steps_between_running_numbers(earlier: str, later: str, steps: int) -> None:
    one, two = running_number(earlier), running_number(later)
    assert one is not None
    assert two is not None
    assert steps_between(one, two) == steps


FILES = names("IMG_%04d", 1, 2, 3, 4)


@cases(
    ("ids", "expected"),
    {
        "same numbers": (names("light_%d", 1, 2, 3, 4), [0, 1, 2, 3]),
        "same, another order": (names("light_%d", 3, 1, 4, 2), [1, 3, 0, 2]),
        "from 0": (names("light_%d", 0, 1, 2, 3), [0, 1, 2, 3]),
        "restarted": (names("light_%04d", 9998, 9999, 1, 2), [0, 1, 2, 3]),
        "angles": (names("az%d", 270, 0, 90, 180), [0, 1, 2, 3]),
        "of spheres": (names("DSC_%d", 5101, 5102, 5104, 5105), [0, 1, 2, 3]),
        "no numbers": (["left", "right", "top", "bottom"], [0, 1, 2, 3]),
        "no names": (["L00", "L01", "L02", "L03"], [0, 1, 2, 3]),
        "a number without image": (names("light_%d", 1, 2, 3, 5), None),
        "from 0, another order": (names("light_%d", 2, 0, 1, 3), None),
    },
)
def test_lights_with_other_names(ids: list[str], expected: list[int] | None) -> None:
    lights = Lights(np.eye(4)[:, :3] + [0, 0, 1], ids=tuple(ids))
    if expected is None:
        with pytest.raises(DataError, match=r"the light light_\d\.png would .* image IMG_000\d"):
            lights.match(FILES)
    else:
        assert lights.match(FILES) == (expected, False)


def test_names_are_the_same_in_other_forms() -> None:
    composed = unicodedata.normalize("NFC", "Büste_01.TIF")
    lights = Lights(np.eye(2)[:, :2] @ [[1, 0, 1], [0, 1, 1]], ids=("x/büste_2.jpg", "büste_1.jpg"))
    assert lights.match([unicodedata.normalize("NFD", composed), "BÜSTE_02"]) == ([1, 0], True)


def test_a_row_that_may_name_two_files_is_refused(tmp_path: Path) -> None:
    fill(tmp_path, ["a_0.png", "a_1.png"])
    (tmp_path / "dome.lp").write_text("2\na_0.jpg 0 0 1\na_1.jpg 0 1 1\n")
    assert read_source(tmp_path).light_ids == ("a_0", "a_1")
    write_png(tmp_path / "A_0.png", np.zeros((4, 6), np.uint16))
    with pytest.raises(DataError, match=r"a_0\.jpg may be A_0\.png or a_0\.png: list the name"):
        read_source(tmp_path)
