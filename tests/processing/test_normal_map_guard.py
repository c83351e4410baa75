"""Normal maps from files that are damaged, too large, or contain invalid vectors."""

from __future__ import annotations

import io

import numpy as np
import pytest

from acquisition import DataError, MissingPathError, write_exr, write_png
from processing import read_normals
from processing.maps.npy_file import read_npy
from rig import Notice
from tests.cases import cases

SIZE = (12, 16)


def dome():
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    x, y = (columns - 7.5) / 12, (5.5 - rows) / 12
    return np.dstack([x, y, np.sqrt(1 - x**2 - y**2)]).astype(np.float32)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("suffix", ["exr", "npy"])
def test_invalid_vectors_are_counted(tmp_path, suffix, bad):
    normals = dome()
    normals[3, 4:7] = bad
    normals[5, 5, 1] = bad
    path = tmp_path / f"n.{suffix}"
    write_exr(path, normals) if suffix == "exr" else np.save(path, normals)
    normal_map, warnings, _ = read_normals(path)
    (notice,) = warnings
    text = "4 pixels have a NaN or infinite vector and are left out of the mask"
    assert notice == Notice("normals-not-finite", text, str(path))
    assert normal_map.mask.sum() == normals[..., 0].size - 4
    assert not normal_map.normals[3, 5].any()
    assert np.isfinite(normal_map.normals).all()


def test_invalid_vectors_outside_the_mask_are_not_counted(tmp_path):
    normals = dome()
    normals[:2] = np.nan
    write_exr(tmp_path / "n.exr", normals)
    mask = np.ones(SIZE, np.uint8)
    mask[0] = 0
    write_png(tmp_path / "mask.png", mask * np.uint8(255))
    warnings = read_normals(tmp_path / "n.exr").warnings
    assert "16 pixels have a NaN" in str(warnings[0])
    assert "16 pixels of the mask have no unit vector" in str(warnings[1])


@pytest.mark.parametrize("far", [1e30, 1e300, 3e38])
def test_vectors_too_long_to_square(tmp_path, far):
    normals = dome().astype(np.float64)
    normals[2, 2] = far
    np.save(tmp_path / "n.npy", normals)
    normal_map = read_normals(tmp_path / "n.npy").normal_map
    assert not normal_map.mask[2, 2]
    assert normal_map.mask.sum() == normals[..., 0].size - 1


@pytest.mark.parametrize("name", ["n.exr", "n.png", "n.npy"])
def test_the_limit_on_pixels(tmp_path, name):
    path = tmp_path / name
    words = np.rint((dome() / 2 + 0.5) * 65535).astype(np.uint16)
    write = {"n.npy": np.save, "n.png": write_png, "n.exr": write_exr}[name]
    write(path, words if name == "n.png" else dome())
    assert read_normals(path, max_pixels=192).normal_map.size == SIZE
    with pytest.raises(DataError, match="are allowed"):
        read_normals(path, max_pixels=142)


def npy(header: str, data: bytes = b"", version: bytes = b"\x01\x00") -> bytes:
    width = 2 if version[0] == 1 else 4
    text = header.encode("latin-1")
    return b"\x93NUMPY" + version + len(text).to_bytes(width, "little") + text + data


@pytest.mark.parametrize("kind", ["<f4", ">f8", "<f2", "|u1", ">u2", "<i8"])
@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("version", [(1, 0), (2, 0), (3, 0)])
def test_arrays_written_by_numpy(tmp_path, kind, order, version):
    values = np.asarray(np.arange(24).reshape(2, 3, 4), kind, order=order)
    file = io.BytesIO()
    np.lib.format.write_array(file, values, version=version)
    (tmp_path / "a.npy").write_bytes(file.getvalue())
    read = read_npy(tmp_path / "a.npy", 24)
    np.testing.assert_array_equal(read, values)
    assert read.dtype == values.dtype


@pytest.mark.parametrize(
    "header",
    [
        "{'shape': (2,3), \"descr\":\"<f4\",'fortran_order':False}\n",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (2L, 3L), }   \n",
    ],
)
def test_arrays_written_by_other_programs(tmp_path, header):
    (tmp_path / "a.npy").write_bytes(npy(header, np.arange(6, dtype="<f4").tobytes()))
    np.testing.assert_array_equal(read_npy(tmp_path / "a.npy", 6), np.arange(6).reshape(2, 3))


GOOD = "{'descr': '<f8', 'fortran_order': False, 'shape': (2, 3), }\n"


@cases(
    ("data", "said"),
    {
        "112 GiB": (npy(GOOD.replace("(2, 3)", "(50000, 100000, 3)")), "allowed"),
        "digits": (npy(GOOD.replace("3)", "9" * 99 + ")")), "header"),
        "truncated": (npy(GOOD, b"\0" * 47), "47 bytes for the shape"),
        "too long": (npy(GOOD, b"\0" * 49), "49 bytes for the shape"),
        "quote": (npy(GOOD.replace("}", "'")), ""),
        "nested": (npy("{" * 9000 + "\n"), "header"),
        "objects": (npy(GOOD.replace("<f8", "|O")), "header"),
        "complex": (npy(GOOD.replace("<f8", "<c16")), "complex"),
        "text": (npy(GOOD.replace("<f8", "<U8")), "type"),
        "long header": (npy("x" * 20_000), "header"),
        "cut header": (npy(GOOD)[:30], "header"),
        "version": (npy(GOOD, version=b"\x07\x00"), "does not begin"),
        "empty": (b"", "does not begin"),
    },
)
def test_damaged_arrays(tmp_path, data, said):
    path = tmp_path / "a.npy"
    path.write_bytes(data)
    with pytest.raises(DataError, match=said or "bytes") as caught:
        read_npy(path, 1000)
    assert str(caught.value).startswith(f"{path}: not a readable array of numbers: ")
    assert "\n" not in str(caught.value)


def test_flipped_bits_in_the_header_of_an_array(tmp_path):
    np.save(tmp_path / "a.npy", dome())
    whole = (tmp_path / "a.npy").read_bytes()
    for place in range(8 * 128):
        changed = bytearray(whole)
        changed[place // 8] ^= 1 << place % 8
        (tmp_path / "a.npy").write_bytes(changed)
        try:
            read_npy(tmp_path / "a.npy", dome().size)
        except DataError:
            continue


def test_a_missing_array(tmp_path):
    with pytest.raises(MissingPathError):
        read_npy(tmp_path / "nowhere.npy", 5)
