"""Camera RAW: linear, with its mosaic and levels, or a clear refusal."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from acquisition._errors import DataError, MissingPathError
from acquisition._images import read_image
from acquisition._raw import is_raw, read_raw

DATA = os.environ.get("SGP_DATA")
needs_data = pytest.mark.skipif(not DATA, reason="SGP_DATA names no folder of real data")


@pytest.fixture
def kodak() -> Path:
    return Path(DATA or "") / "raw" / "RAW_KODAK_DC50.KDC"


@needs_data
def test_a_real_file_is_read_as_the_sensor_saw_it(kodak: Path) -> None:
    raw = read_raw(kodak)
    assert raw.pixels.shape == (512, 768)
    assert raw.pixels.dtype == np.uint16
    assert raw.pixels.flags.owndata
    assert (raw.black_level_dn, raw.white_level_dn) == (0, 16383)
    assert raw.pixels.max() <= 16383
    # LibRaw lists the colours as RGBG and lays them out as 1 0 / 2 3.
    assert raw.cfa == "GRBG"
    # The two greens of a block see nearly the same light, red and blue another: the pattern is
    # not shifted by a row or column.
    planes = {
        (row, column): raw.pixels[row::2, column::2].astype(float)
        for row in (0, 1)
        for column in (0, 1)
    }

    def apart(a: tuple[int, int], b: tuple[int, int]) -> float:
        return float(np.median(np.abs(planes[a] - planes[b])))

    assert apart((0, 0), (1, 1)) < 0.5 * min(apart((0, 0), (0, 1)), apart((0, 0), (1, 0)))


@needs_data
def test_it_is_not_mistaken_for_the_tiff_it_also_is(kodak: Path) -> None:
    with pytest.raises(DataError, match="RAW"):
        read_image(kodak)


@needs_data
@pytest.mark.parametrize("keep", [0, 100, 5000, 46337, 92674])
def test_a_file_cut_short_is_named(kodak: Path, tmp_path: Path, keep: int) -> None:
    path = tmp_path / "cut.kdc"
    path.write_bytes(kodak.read_bytes()[:keep])
    with pytest.raises(DataError, match=r"cut\.kdc: not a readable camera RAW") as caught:
        read_raw(path)
    assert "\n" not in str(caught.value)


def test_what_is_no_raw(tmp_path: Path) -> None:
    path = tmp_path / "a.nef"
    path.write_bytes(b"hello " * 1000)
    with pytest.raises(DataError, match=r"a\.nef"):
        read_raw(path)
    with pytest.raises(DataError, match="not a readable"):
        read_raw(tmp_path)
    with pytest.raises(MissingPathError, match=r"none\.dng"):
        read_raw(tmp_path / "none.dng")


@pytest.mark.parametrize(
    ("name", "expected"), [("a.KDC", True), ("a.cr3", True), ("a.tif", False), ("raw", False)]
)
def test_raw_is_told_by_suffix(name: str, expected: bool) -> None:
    assert is_raw(Path(name)) is expected
