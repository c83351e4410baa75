"""Camera RAW files: read as linear mosaics with their levels, or refused with a clear message."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import (
    DataError,
    Lights,
    MissingPathError,
    import_frames,
    read_image,
    read_source,
    verify_session,
    watch_folder,
    write_png,
)
from acquisition.imports import Watch, lights_in_order, read_import
from acquisition.imports.image import read_for_import
from acquisition.pixels import image_facts, read_raw
from acquisition.values.image_names import is_raw
from rig.arrays import Int64
from tests.acquisition.dng_file import SHORT, SRATIONAL, Tag, dng, tag
from tests.cases import cases
from tests.real_data import DATA, needs_data

SENSOR = np.random.default_rng(3).integers(64, 4090, (40, 60)).astype(np.uint16)


def write_all(folder: Path, *files: bytes) -> None:
    folder.mkdir()
    for number, data in enumerate(files):
        (folder / f"IMG_{number}.dng").write_bytes(data)


def test_margins_orientation_and_levels_of_each_colour(tmp_path: Path) -> None:
    """Only the active area, not rotated, with the black level of each mosaic position."""
    path = tmp_path / "a.dng"
    path.write_bytes(
        dng(SENSOR, black=(60, 64, 66, 70), white=4000, active=(2, 4, 38, 58), orientation=6)
    )
    raw = read_raw(path)
    np.testing.assert_array_equal(raw.pixels, SENSOR[2:38, 4:58])
    assert raw.cfa == "RGGB"
    assert raw.black_levels_dn == (60, 64, 66, 70)
    assert (raw.black_level_dn, raw.white_level_dn) == (65, 4000)
    assert (raw.exposure_us, raw.iso) == (5000, 400)
    assert raw.taken == datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)


@cases(
    ("numbers", "cfa"),
    {
        "RGGB": ((0, 1, 1, 2), "RGGB"),
        "BGGR": ((2, 1, 1, 0), "BGGR"),
        "GRBG": ((1, 0, 2, 1), "GRBG"),
        "GBRG": ((1, 2, 0, 1), "GBRG"),
    },
)
def test_every_mosaic_is_named_from_the_top_left(
    tmp_path: Path, numbers: tuple[int, int, int, int], cfa: str
) -> None:
    path = tmp_path / "a.dng"
    path.write_bytes(dng(SENSOR, cfa=numbers, black=(60, 64, 66, 70)))
    raw = read_raw(path)
    assert raw.cfa == cfa
    assert raw.black_levels_dn == (60, 64, 66, 70)
    np.testing.assert_array_equal(raw.pixels, SENSOR)


def test_camera_and_exposure_of_a_raw_file_are_read_without_decoding(tmp_path: Path) -> None:
    path = tmp_path / "a.dng"
    path.write_bytes(dng(SENSOR, exposure=(1, 8000), iso=100))
    data = image_facts(path).shot
    assert (data.exposure_us, data.iso, data.vendor, data.model) == (125, 100, "Acme", "Acme One")
    assert data == read_for_import(path).facts.shot
    path.write_bytes(dng(SENSOR, exposure=(0, 1), iso=0, taken=""))
    assert image_facts(path).shot.exposure_us is None
    assert read_raw(path).iso is None


def test_raw_files_become_a_session_with_all_their_metadata(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for number in range(3):
        (tmp_path / "in" / f"IMG_{number}.dng").write_bytes(
            dng(SENSOR + number, black=(60, 64, 66, 70), white=4200, exposure=(number + 1, 100))
        )
    lights = Lights(directions=np.eye(3) + 0.1)
    session = import_frames(read_import(tmp_path / "in", lights=lights), tmp_path / "out")
    assert verify_session(tmp_path / "out").ok
    camera = session.manifest.camera
    assert (camera.cfa, camera.black_level_dn, camera.white_dn) == ("RGGB", 65, 4200)
    assert (camera.vendor, camera.model, camera.bit_depth) == ("Acme", "Acme One", 13)
    assert [frame.exposure_us for frame in session.frames] == [10_000, 20_000, 30_000]
    second = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC).timestamp()
    assert session.frames[0].line.timestamp_ns == second * 10**9
    for number, frame in enumerate(session.frames):
        np.testing.assert_array_equal(frame.read(), SENSOR + number)
    (event,) = session.events
    assert event.event == "imported"
    assert event.details["iso"] == 400
    assert event.details["black_levels_dn"] == [60, 64, 66, 70]
    again = read_source(tmp_path / "out")
    assert (again.cfa, again.black_level, again.white_level) == ("RGGB", 65, 4200)


@cases(
    ("change", "said"),
    {
        "white": ({"white": 4000}, "white level 4000"),
        "black": ({"black": (99, 99, 99, 99)}, "black level 99"),
        "mosaic": ({"cfa": (2, 1, 1, 0)}, "colour filter BGGR"),
        "size": ({"active": (0, 0, 38, 58)}, r"pixels \(38, 58\)"),
    },
)
def test_a_raw_file_with_other_camera_settings_is_refused(
    tmp_path: Path, change: dict[str, Any], said: str
) -> None:
    write_all(tmp_path / "in", dng(SENSOR), dng(SENSOR, **change))
    with pytest.raises(DataError, match=rf"IMG_1\.dng: {said}"):
        import_frames(read_import(tmp_path / "in"), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_black_level_that_varies_slightly_between_frames_is_accepted(tmp_path: Path) -> None:
    write_all(tmp_path / "in", dng(SENSOR), dng(SENSOR, black=(66, 66, 66, 66)))
    assert import_frames(read_import(tmp_path / "in"), tmp_path / "out").complete


@pytest.mark.usefixtures("world")
def test_a_tethered_camera_that_writes_raw_and_jpeg(tmp_path: Path) -> None:
    """RAW files count, other images do not; the camera's clock shows the missing shot."""
    (tmp_path / "in").mkdir()
    for number, second in enumerate((0, 5, 10, 20, 25, 30)):
        data = dng(SENSOR + number, taken=f"2026:01:02 03:04:{second:02d}")
        (tmp_path / "in" / f"IMG_{number}.dng").write_bytes(data)
        write_png(tmp_path / "in" / f"IMG_{number}.png", np.zeros((4, 4), np.uint8))
    watch = Watch(tmp_path / "in", lights_in_order(7), interval_s=5.0, timeout_s=0.6, settle_s=0.05)
    result = watch_folder(watch, tmp_path / "out")
    assert [shot.led for shot in result.missing] == [3]
    for number, frame in enumerate(result.session.frames):
        np.testing.assert_array_equal(frame.read(), SENSOR + number)
    assert result.session.manifest.camera.cfa == "RGGB"
    assert verify_session(tmp_path / "out").ok


MONO = [tag(262, SHORT, (34892,)), tag(50713, SHORT, (1, 1)), tag(50714, SHORT, (64,))]


def ramp(levels: Int64) -> Tag:
    """Build BlackLevelDeltaV."""
    return tag(50716, SRATIONAL, tuple(int(part) for level in levels for part in (level, 1)))


def test_a_black_level_that_varies_along_rows_is_levelled(tmp_path: Path) -> None:
    rise = np.arange(40) * 4
    light = np.minimum(SENSOR, 3000)
    data = np.where(SENSOR > 4000, 4095, light + 40 + rise[:, None]).astype(np.uint16)
    path = tmp_path / "a.dng"
    path.write_bytes(dng(data, black=(40, 40, 40, 40), other=[ramp(rise)]))
    raw = read_raw(path)
    assert raw.black_levels_dn == (118,) * 4
    np.testing.assert_array_equal(raw.pixels, np.where(SENSOR > 4000, 4095, light + 118))


def test_a_source_has_one_black_level_and_a_session_keeps_the_samples(tmp_path: Path) -> None:
    frames = [np.minimum(SENSOR + number, 4000) for number in range(3)]
    write_all(tmp_path / "in", *(dng(data, black=(60, 64, 66, 70)) for data in frames))
    levelled = SENSOR.astype(int)
    levelled[::2, ::2] += 5
    levelled[::2, 1::2] += 1
    levelled[1::2, ::2] -= 1
    levelled[1::2, 1::2] -= 5
    import_frames(read_import(tmp_path / "in"), tmp_path / "out")
    for folder in ("in", "out"):
        source = read_source(tmp_path / folder)
        np.testing.assert_array_equal(
            source.frames[0].read(), np.where(SENSOR >= 4000, source.frames[0].read(), levelled)
        )
        assert source.black_level == 65


def test_clipping_is_found_in_files_whose_black_levels_differ_slightly(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    for number in range(4):
        data = np.minimum(rng.integers(64, 4090, (40, 60)), 3000).astype(np.uint16)
        (tmp_path / f"a{number}.dng").write_bytes(dng(data, black=(64 + number % 2,) * 4))
    source = read_source(tmp_path)
    assert source.white_level == 2999.5
    assert all((frame.read() >= 2999.5).mean() > 0.25 for frame in source.frames)


@pytest.mark.usefixtures("world")
def test_a_camera_without_a_colour_filter_is_read_watched_and_imported(tmp_path: Path) -> None:
    write_all(tmp_path / "in", *(dng(SENSOR + number, other=MONO) for number in range(3)))
    raw = read_raw(tmp_path / "in" / "IMG_0.dng")
    assert (raw.cfa, raw.black_levels_dn) == (None, (64,))
    np.testing.assert_array_equal(raw.pixels, SENSOR)
    watch = Watch(tmp_path / "in", lights_in_order(3), timeout_s=0.6, settle_s=0.05)
    watched = watch_folder(watch, tmp_path / "watched").session
    imported = import_frames(read_import(tmp_path / "in"), tmp_path / "imported")
    for session in (watched, imported):
        camera = session.manifest.camera
        assert (camera.cfa, camera.black_level_dn, camera.white_dn) == (None, 64, 4095)
        np.testing.assert_array_equal(session.frames[2].read(), SENSOR + 2)


@cases(
    ("other", "said"),
    {
        "float": ([tag(339, SHORT, (3,))], "floating-point"),
        "codec": ([tag(259, SHORT, (8,))], "Deflate"),
        "staggered": ([tag(50711, SHORT, (2,))], "CFALayout"),
        "table": ([tag(50713, SHORT, (3, 3))], "BlackLevel has 4 values"),
        "table without columns": ([tag(50713, SHORT, (2,))], "BlackLevel"),
        "short ramp": ([ramp(np.arange(9))], "BlackLevelDeltaV has 9"),
        "filter": ([tag(33421, SHORT, (0, 4))], "CFAPattern"),
        "not a number": ([tag(50716, SRATIONAL, (1, 0) * 40)], "black levels .* damaged"),
    },
)
def test_what_cannot_be_read_as_stated_is_refused(
    tmp_path: Path, other: list[Tag], said: str
) -> None:
    path = tmp_path / "a.dng"
    path.write_bytes(dng(SENSOR, other=other))
    with pytest.raises(DataError, match=said):
        read_raw(path)


@cases(
    ("stated", "block"),
    {
        "of colours": ((3000, 4000, 3500), [[3000, 4000], [4000, 3500]]),
        "of positions": ((3000, 4000, 3900, 3500), [[3000, 4000], [3900, 3500]]),
        "unclear": ((3000, 4000), [[3000, 3000], [3000, 3000]]),
    },
)
def test_white_levels_of_colours_are_used(
    tmp_path: Path, stated: tuple[int, ...], block: list[list[int]]
) -> None:
    path = tmp_path / "a.dng"
    path.write_bytes(dng(SENSOR, other=[tag(50717, SHORT, stated)]))
    raw = read_raw(path)
    assert raw.white_level_dn == np.max(block)
    saturated = np.tile(block, (20, 30)) <= SENSOR
    np.testing.assert_array_equal(raw.pixels >= raw.white_level_dn, saturated)
    np.testing.assert_array_equal(raw.pixels[~saturated], SENSOR[~saturated])


@pytest.fixture
def kodak() -> Path:
    return DATA / "raw" / "RAW_KODAK_DC50.KDC"


@needs_data
def test_a_real_file_is_read_unprocessed(kodak: Path) -> None:
    raw = read_raw(kodak)
    assert raw.pixels.shape == (512, 768)
    assert raw.pixels.dtype == np.uint16
    assert raw.pixels.flags.owndata
    assert (raw.black_level_dn, raw.white_level_dn) == (0, 16383)
    assert (raw.exposure_us, raw.iso) == (4350, 84)
    assert raw.taken == datetime(1997, 4, 23, 8, 0, 47, tzinfo=UTC)
    assert raw.pixels.max() <= 16383
    # LibRaw lists the colours as RGBG and arranges them as 1 0 / 2 3.
    assert raw.cfa == "GRBG"
    # Both greens of a block receive nearly the same light, red and blue do not: the pattern is not
    # shifted by a row or column.
    planes = {
        (row, column): raw.pixels[row::2, column::2].astype(float)
        for row in (0, 1)
        for column in (0, 1)
    }

    def difference(a: tuple[int, int], b: tuple[int, int]) -> float:
        return float(np.median(np.abs(planes[a] - planes[b])))

    others = difference((0, 0), (0, 1)), difference((0, 0), (1, 0))
    assert difference((0, 0), (1, 1)) < 0.5 * min(others)


@needs_data
def test_a_raw_file_is_not_read_as_the_tiff_that_it_also_is(kodak: Path) -> None:
    with pytest.raises(DataError, match="RAW"):
        read_image(kodak)


@needs_data
@pytest.mark.parametrize("keep", [0, 100, 5000, 46337, 92674])
def test_a_truncated_file_is_refused_by_name(kodak: Path, tmp_path: Path, keep: int) -> None:
    path = tmp_path / "cut.kdc"
    path.write_bytes(kodak.read_bytes()[:keep])
    with pytest.raises(DataError, match=r"cut\.kdc: not a readable camera RAW") as caught:
        read_raw(path)
    assert "\n" not in str(caught.value)


def test_files_that_are_not_raw(tmp_path: Path) -> None:
    path = tmp_path / "a.nef"
    path.write_bytes(b"hello " * 1000)
    with pytest.raises(DataError, match=r"a\.nef"):
        read_raw(path)
    with pytest.raises(DataError, match="a folder, not a file"):
        read_raw(tmp_path)
    with pytest.raises(MissingPathError, match=r"none\.dng"):
        read_raw(tmp_path / "none.dng")


@pytest.mark.parametrize(
    ("name", "expected"), [("a.KDC", True), ("a.cr3", True), ("a.tif", False), ("raw", False)]
)
def test_raw_is_recognised_by_suffix(name: str, expected: bool) -> None:
    assert is_raw(Path(name)) is expected
