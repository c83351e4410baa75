"""Image files that are written: their pixels, layouts and bytes."""

from __future__ import annotations

import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from acquisition import DataError, StorageError, read_image, write_exr, write_png
from acquisition.pixels import write_tiff
from tests.acquisition.image_bytes import NOISE, RGB16


@pytest.mark.parametrize("shape", [(4, 5), (4, 5, 3), (1, 1), (1, 7, 3)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_tiff_holds_the_unchanged_samples(
    tmp_path: Path, shape: tuple[int, ...], dtype: type
) -> None:
    pixels = np.random.default_rng(3).integers(0, np.iinfo(dtype).max, shape).astype(dtype)
    path = tmp_path / "a.tif"
    write_tiff(path, pixels)
    data = path.read_bytes()
    assert data[:2] == b"II"
    assert pixels.tobytes() in data
    other = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(other[..., ::-1] if len(shape) == 3 else other, pixels)
    np.testing.assert_array_equal(read_image(path), pixels)


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    pixels=hnp.arrays(
        np.float32,
        st.sampled_from([(3, 4), (2, 3, 3)]),
        elements=st.floats(width=32, allow_nan=True, allow_infinity=True),
    )
)
def test_exr_keeps_every_float(tmp_path: Path, pixels: np.ndarray) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, pixels)
    np.testing.assert_array_equal(read_image(path), pixels)


def test_exr_is_compressed_where_pixels_are_zero(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).random((64, 80), np.float32)
    write_exr(tmp_path / "noise.exr", noise)
    assert oiio.ImageInput.open(str(tmp_path / "noise.exr")).spec()["compression"] == "none"
    noise[:, :40] = 0
    write_exr(tmp_path / "half.exr", noise)
    assert (tmp_path / "half.exr").stat().st_size < 0.65 * noise.nbytes
    np.testing.assert_array_equal(read_image(tmp_path / "half.exr"), noise)


@pytest.mark.parametrize(
    "view",
    [
        pytest.param(lambda a: a[:, ::2], id="strided"),
        pytest.param(lambda a: a.T, id="transposed"),
        pytest.param(lambda a: a[::-1], id="reversed"),
        pytest.param(lambda a: np.asfortranarray(a), id="fortran"),
        pytest.param(lambda a: a.astype(">u2"), id="big-endian"),
    ],
)
def test_arrays_in_any_memory_layout(tmp_path: Path, view: object) -> None:
    pixels = view(np.arange(42, dtype=np.uint16).reshape(6, 7) * 1000)  # type: ignore[operator]
    for name, write in (("a.tif", write_tiff), ("a.png", write_png)):
        write(tmp_path / name, pixels)
        np.testing.assert_array_equal(read_image(tmp_path / name), pixels)


def test_equal_pixels_give_equal_bytes_at_any_time(tmp_path: Path) -> None:
    def write(folder: Path) -> list[bytes]:
        folder.mkdir()
        write_tiff(folder / "a.tif", RGB16)
        write_png(folder / "a.png", RGB16)
        write_exr(folder / "a.exr", RGB16.astype(np.float32))
        return [path.read_bytes() for path in sorted(folder.iterdir())]

    first = write(tmp_path / "first")
    time.sleep(1.05 - time.time() % 1)  # in the next second, by which files are dated
    assert write(tmp_path / "second") == first


def test_two_dimensional_arrays_are_written_wrong_by_the_library_alone(tmp_path: Path) -> None:
    # If OpenImageIO fixes this bug, the reshape in the writer can be removed.
    pixels = np.arange(20, dtype=np.uint16).reshape(4, 5)
    spec = oiio.ImageSpec(5, 4, 1, oiio.UINT16)
    file = oiio.ImageOutput.create("tiff")
    assert file.open(str(tmp_path / "a.tif"), spec)
    file.write_image(pixels)
    file.close()
    try:
        wrong = not np.array_equal(read_image(tmp_path / "a.tif"), pixels)
    except DataError:
        wrong = True
    assert wrong
    write_tiff(tmp_path / "b.tif", pixels)
    np.testing.assert_array_equal(read_image(tmp_path / "b.tif"), pixels)


@pytest.mark.parametrize(
    ("write", "pixels"),
    [
        pytest.param(write_tiff, np.ones((3, 4), np.int32), id="int32 would be rescaled"),
        pytest.param(write_tiff, np.ones((3, 4), np.float32), id="float tiff"),
        pytest.param(write_png, np.ones((3, 4), bool), id="bool"),
        pytest.param(write_exr, np.ones((3, 4), np.uint16), id="uint16 exr would become half"),
        pytest.param(write_exr, np.ones((3, 4), np.float64), id="double exr"),
        pytest.param(write_png, np.ones((3, 4, 4), np.uint8), id="4 channels"),
        pytest.param(write_png, np.ones((3, 4, 1), np.uint8), id="an axis of length 1"),
        pytest.param(write_png, np.ones(3, np.uint8), id="1-D"),
        pytest.param(write_png, np.ones((0, 4), np.uint8), id="no pixels"),
    ],
)
def test_arrays_that_are_refused(tmp_path: Path, write: object, pixels: np.ndarray) -> None:
    with pytest.raises(DataError, match="a file"):
        write(tmp_path / "a file", pixels)  # type: ignore[operator]
    assert list(tmp_path.iterdir()) == []


@contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize(
    ("write", "pixels"),
    [
        pytest.param(write_tiff, RGB16, id="tiff"),
        pytest.param(write_png, RGB16, id="png"),
        pytest.param(write_exr, NOISE.astype(np.float32), id="exr"),
    ],
)
def test_a_disk_that_fills_up_at_any_byte(
    tmp_path: Path, write: object, pixels: np.ndarray
) -> None:
    path = tmp_path / "a"
    write(path, np.zeros_like(pixels))  # type: ignore[operator]
    before = path.read_bytes()
    write(tmp_path / "whole", pixels)  # type: ignore[operator]
    size = (tmp_path / "whole").stat().st_size
    refused = 0
    for limit in range(1, size, max(1, size // 150)):
        with file_size_limit(limit):
            message = ""
            try:
                write(path, pixels)  # type: ignore[operator]
            except StorageError as error:
                message = str(error)
        if message:
            refused += 1
            assert str(path) in message
            assert path.read_bytes() == before
        else:
            # Only metadata may be missing.
            np.testing.assert_array_equal(read_image(path), pixels)
            write(path, np.zeros_like(pixels))  # type: ignore[operator]
        assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "whole"]
    assert refused > 50


def test_png_is_compressed_fast(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", np.zeros((4, 6), np.uint16))
    data = (tmp_path / "a.png").read_bytes()
    # Two bits in the header of a zlib stream give the compression effort: 0 is the fastest.
    assert data[data.index(b"IDAT") + 5] >> 6 == 0
