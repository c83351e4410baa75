"""Exposure times of a series of images: applied, assumed or refused; errors of their rounding."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile

from acquisition import DataError, Lights, import_frames, read_source
from acquisition.imports import read_import
from acquisition.pixels import ImageFacts, ShotFacts
from acquisition.source.series_facts import exposure_times, reference_times
from calibration import linear_stack

WHERE = Path("series")
LIGHTS = Lights(directions=np.array([[1.0, 0, 1], [0, 1, 1], [-1, 0, 1]]))


def facts(*times_s: float | None, shutter_s: tuple[float | None, ...] = ()) -> list[ImageFacts]:
    def us(time_s: float | None) -> float | None:
        return None if time_s is None else time_s * 1e6

    finer = shutter_s or (None,) * len(times_s)
    return [
        ImageFacts(Path(f"{i}.tif"), ShotFacts(exposure_us=us(time), shutter_us=us(fine)))
        for i, (time, fine) in enumerate(zip(times_s, finer, strict=True))
    ]


TIMES = {
    "not stated": (facts(None, None), (None, None), []),
    "equal": (facts(0.02, 0.02), (0.02, 0.02), []),
    "equal but for rounding": (facts(0.02, 0.020_001), (0.02, 0.02), []),
    "one not stated": (facts(0.02, None), (0.02, 0.02), ["exposure-times-assumed"]),
    "different": (facts(0.02, 0.04), (0.02, 0.04), ["exposure-times-applied"]),
    "finer": (
        facts(1 / 60, 1 / 30, shutter_s=(1 / 64, 1 / 32)),
        (1 / 64, 1 / 32),
        ["exposure-times-applied"],
    ),
    "not finer for all": (facts(1 / 60, 1 / 60, shutter_s=(1 / 64, None)), (1 / 60, 1 / 60), []),
}


@pytest.mark.parametrize(("images", "expected", "codes"), TIMES.values(), ids=TIMES)
def test_times_of_a_series(
    images: list[ImageFacts], expected: tuple[float | None, ...], codes: list[str]
) -> None:
    times = exposure_times(images, WHERE)
    assert times.us == pytest.approx(tuple(t and t * 1e6 for t in expected))
    assert [notice.code for notice in times.notices] == codes


def test_a_missing_time_is_refused_where_others_differ() -> None:
    with pytest.raises(DataError, match=r"2\.tif: states no exposure time, .*1/60 s to 1/30 s"):
        exposure_times(facts(1 / 60, 1 / 30, None), WHERE)


@pytest.mark.parametrize(
    ("images", "expected"),
    [
        # 1/60 stands for 1/64, 1/125 for 1/128: 6.7 % and 2.4 %, evenly between none and all.
        pytest.param(
            facts(1 / 60, 1 / 60, 1 / 125), (0, 0, np.hypot(4 / 60, 3 / 125) / 3**0.5),
            id="markings",
        ),
        pytest.param(facts(0.0123, 0.0123, 0.0246), (0, 0, 0), id="not markings"),
        pytest.param(facts(1 / 60, 1 / 30, shutter_s=(1 / 64, 1 / 32)), (0, 0), id="finer"),
        pytest.param(facts(1 / 60, 1 / 60), (0, 0), id="equal"),
    ],
)  # fmt: skip
def test_errors_of_rounded_times(images: list[ImageFacts], expected: tuple[float, ...]) -> None:
    assert exposure_times(images, WHERE).sigma == pytest.approx(expected)


@pytest.mark.parametrize(
    ("images", "dark", "expected"),
    [
        pytest.param(facts(0.02, 0.02), None, (20_000, True), id="as the images"),
        pytest.param(facts(0.02, 0.02), 0.04, (40_000, False), id="its own"),
        pytest.param(facts(0.02, 0.04), None, (None, False), id="not known"),
        pytest.param(facts(None, None), 0.04, (None, True), id="images without times"),
    ],
)
def test_times_of_dark_frames(
    images: list[ImageFacts], dark: float | None, expected: tuple[float | None, bool]
) -> None:
    (time,), assumed = reference_times(facts(dark), exposure_times(images, WHERE))
    assert (time, assumed) == expected


def write(folder: Path, *times: tuple[int, int] | None, gains: tuple[float, ...] = ()) -> None:
    folder.mkdir()
    for i, time in enumerate(times):
        tags = [] if time is None else [(33434, "2I", 1, time, True)]
        level = 8000 * (gains[i] if gains else 1)
        tifffile.imwrite(folder / f"a.{i}.tif", np.full((6, 8), level, np.uint16), extratags=tags)


def test_images_are_divided_by_their_times_in_folders_and_sessions(tmp_path: Path) -> None:
    write(tmp_path / "in", (1, 60), (1, 30), (1, 60), gains=(1, 2, 1))
    source = read_source(tmp_path / "in", lights=LIGHTS)
    stack = linear_stack(source)
    np.testing.assert_allclose(stack.values, stack.values[0, 0, 0], rtol=1e-6)
    assert source.lights is not None
    assert source.lights.errors is not None
    deviations = np.asarray(source.lights.errors.intensity_std)[:, 0]
    assert deviations == pytest.approx([0, np.hypot(4 / 60, 2 / 30) / 3**0.5, 0])
    session = tmp_path / "session"
    import_frames(read_import(tmp_path / "in", lights=LIGHTS), session)
    again = linear_stack(read_source(session))
    np.testing.assert_array_equal(again.values, stack.values)


@pytest.mark.parametrize("time", [(1, 60), None])
def test_equal_times_change_nothing(tmp_path: Path, time: tuple[int, int] | None) -> None:
    write(tmp_path / "in", time, time, time)
    tifffile.imwrite(tmp_path / "in" / "dark.tif", np.full((6, 8), 500, np.uint16))
    source = read_source(tmp_path / "in", lights=LIGHTS)
    assert source.lights is not None
    assert source.lights.errors is None
    assert [notice.code for notice in source.warnings] == [
        "reference-frames-found", "lights-matched-by-order",
    ]  # fmt: skip
    np.testing.assert_allclose(linear_stack(source).values, 7500 / 65535, rtol=1e-6)


def test_sessions_keep_how_viewers_turn_their_images(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    tags = [(274, "H", 1, 3, True), (34855, "H", 1, 200, True)]
    inside = np.full((6, 8), 255, np.uint8)
    for i in range(3):
        tifffile.imwrite(
            tmp_path / "in" / f"a.{i}.tif", np.full((6, 8), 700, np.uint16), extratags=tags
        )
    tifffile.imwrite(tmp_path / "in" / "mask.tif", inside, extratags=tags[:1])
    source = read_import(tmp_path / "in")
    assert [notice.code for notice in source.warnings] == ["orientation-tag"]
    session = import_frames(source, tmp_path / "session")
    details = session.events[0].details
    assert (details["iso"], details["orientation"]) == (200, 3)
    assert read_source(tmp_path / "session").mask is not None
    tifffile.imwrite(tmp_path / "upright.tif", inside)
    with pytest.raises(DataError, match=r"upright\.tif: a mask with the Orientation tag 1"):
        read_source(tmp_path / "session", mask_path=tmp_path / "upright.tif")
    read_source(tmp_path / "session", mask_path=tmp_path / "in" / "mask.tif")
