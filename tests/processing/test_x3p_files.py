"""X3P files: exact heights, a reader of our own by the standard, and files that are refused."""

from __future__ import annotations

import hashlib
import io
import struct
import zipfile
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from acquisition import DataError, MissingPathError
from processing.surface import X3pOrigin, X3pSurface, read_x3p, write_x3p

# Heights rise to the right and, by ten times as much, upward.
RISING = (np.arange(4) + 10 * np.arange(3)[::-1, None]).astype(np.float32) / 7
RISING[0, 3] = np.nan
DATE = datetime(2026, 11, 22, 14, 41, 34, 500000, UTC)
ORIGIN = X3pOrigin(date=DATE, creator="A. Öz", comment="object: <owl> & co\nsha256 00")
FLOATS = st.floats(width=32, allow_infinity=False) | st.sampled_from([0.0, -0.0, 1e-45, 3.4e38])


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    height=arrays.arrays(
        np.float32, arrays.array_shapes(min_dims=2, max_dims=2, max_side=6), elements=FLOATS
    ).filter(lambda height: not np.isnan(height).all()),
    pixel_mm=st.floats(1e-6, 1e3),
)
def test_every_height_is_read_back_exactly(
    tmp_path: Path, height: np.ndarray, pixel_mm: float
) -> None:
    write_x3p(tmp_path / "a.x3p", height, pixel_mm, origin=ORIGIN)
    again = read_x3p(tmp_path / "a.x3p")
    np.testing.assert_array_equal(again.height, height)
    assert again.height.dtype == np.float32
    assert again.pixel_mm == pytest.approx(pixel_mm, rel=1e-14)


def members(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as file:
        return {name: file.read(name) for name in file.namelist()}


def test_the_file_by_the_standard(tmp_path: Path) -> None:
    """Read by another way than the library: metres, the lowest row first, checksums."""
    write_x3p(tmp_path / "a.x3p", RISING, 0.05, origin=ORIGIN)
    parts = members(tmp_path / "a.x3p")
    root = ET.fromstring(parts["main.xml"])
    stated = {element.tag: (element.text or "").strip() for element in root.iter()}
    assert root.tag == "{http://www.opengps.eu/2008/ISO5436_2}ISO5436_2"
    assert (stated["Revision"], stated["FeatureType"]) == ("ISO5436 - 2000", "SUR")
    for axis, kind in (("CX", "I"), ("CY", "I"), ("CZ", "A")):
        found = root.find(f"Record1/Axes/{axis}")
        assert found is not None
        assert found.findtext("AxisType") == kind
        assert float(found.findtext("Increment", "")) == (1 if kind == "A" else pytest.approx(5e-5))
    size = [int(stated[f"Size{axis}"]) for axis in "XYZ"]
    assert size == [4, 3, 1]
    assert stated["DataType"] == "D"
    values = struct.unpack("<12d", parts[stated["PointDataLink"]])
    # The first values are those of the lowest row, from left to right.
    assert values[:4] == pytest.approx([0, 1 / 7e3, 2 / 7e3, 3 / 7e3])
    assert values[4] == pytest.approx(10 / 7e3)
    assert np.isnan(values[11])
    digest = hashlib.md5(parts[stated["PointDataLink"]]).hexdigest()
    assert stated["MD5ChecksumPointData"].lower() == digest
    named = parts[stated["ChecksumFile"]].split()
    assert named == [hashlib.md5(parts["main.xml"]).hexdigest().encode(), b"*main.xml"]
    assert stated["Date"] == "2026-11-22T14:41:34.5+00:00"
    assert stated["Type"] == "NonContacting"
    assert (stated["Creator"], stated["Comment"]) == (ORIGIN.creator, ORIGIN.comment)


def test_the_origin_is_read_back_and_bytes_are_equal(tmp_path: Path) -> None:
    origin = X3pOrigin(DATE, "A", "Maker", "M2", "40", "1.0", "software", "a simulated rig", "x")
    for name in ("a.x3p", "b.x3p"):
        write_x3p(tmp_path / name, RISING, 0.05, origin=origin)
    assert read_x3p(tmp_path / "a.x3p").origin == origin
    assert (tmp_path / "a.x3p").read_bytes() == (tmp_path / "b.x3p").read_bytes()


AXIS = "<{0}><AxisType>{1}</AxisType><DataType>{2}</DataType><Increment>{3}</Increment>{4}</{0}>"
SHORTS = struct.pack("<6h", 1, 2, 3, 4, 5, -6)


def foreign(
    path: Path,
    data: bytes = SHORTS,
    *,
    z: tuple[str, ...] = ("A", "I", "1e-6", "<Offset>1e-3</Offset>"),
    steps: tuple[str, str] = ("5e-5", "5e-5"),
    sizes: str = "<SizeX>3</SizeX><SizeY>2</SizeY><SizeZ>1</SizeZ>",
    feature: str = "SUR",
    digest: str | None = None,
    more: str = "",
    valid: bytes | None = None,
    kind: str = "I",
    extra: dict[str, bytes] | None = None,
) -> Path:
    """Write the file of another program."""
    axes = AXIS.format("CX", kind, "D", steps[0], "") + AXIS.format("CY", kind, "D", steps[1], "")
    said = hashlib.md5(data).hexdigest() if digest is None else digest
    sums = f"<MD5ChecksumPointData>{said}</MD5ChecksumPointData>" if said else ""
    if valid is not None:
        sums += "<ValidPointsLink>bindata/valid.bin</ValidPointsLink>"
    text = (
        '<?xml version="1.0"?><p:ISO5436_2 xmlns:p="http://www.opengps.eu/2008/ISO5436_2">'
        f"<Record1><Revision>ISO5436 - 2000</Revision><FeatureType>{feature}</FeatureType>"
        f"<Axes>{axes}{AXIS.format('CZ', *z)}{more}</Axes></Record1><Record3>"
        f"<MatrixDimension>{sizes}</MatrixDimension><DataLink><PointDataLink>bindata/data.bin"
        f"</PointDataLink>{sums}</DataLink></Record3></p:ISO5436_2>"
    )
    parts = {"main.xml": text.encode(), "bindata/data.bin": data, **(extra or {})}
    if valid is not None:
        parts["bindata/valid.bin"] = valid
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in parts.items():
            file.writestr(name, content)
    return path


def test_integers_with_an_increment_an_offset_and_a_validity_file(tmp_path: Path) -> None:
    # Bits from the least significant one: all points but the fifth are valid.
    found = read_x3p(foreign(tmp_path / "a.x3p", valid=bytes([0b101111])))
    assert isinstance(found, X3pSurface)
    expected = [[1.004, np.nan, 0.994], [1.001, 1.002, 1.003]]
    np.testing.assert_array_equal(found.height, np.array(expected, np.float32))
    assert found.pixel_mm == 0.05
    assert found.origin == X3pOrigin(None, "", "", "", "", "", "", "", "")


ROTATED = (
    "<Rotation>"
    + "".join(
        f"<r{i}{j}>{value}</r{i}{j}>"
        for i, row in enumerate(((0, -1, 0), (1, 0, 0), (0, 0, 1)), 1)
        for j, value in enumerate(row, 1)
    )
    + "</Rotation>"
)
LAYERS = "<SizeX>3</SizeX><SizeY>1</SizeY><SizeZ>2</SizeZ>"
HUGE = "<SizeX>30000</SizeX><SizeY>30000</SizeY><SizeZ>1</SizeZ>"
DOUBLES = struct.pack("<6d", *[1e300] * 6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"digest": ""}, "states no MD5 checksum of its heights"),
        ({"digest": "0" * 32}, "is not X3P: The MD5 checksum of 'bindata/data.bin' does not match"),
        ({"steps": ("0.05", "0.05"), "sizes": HUGE}, "states 1500 x 1500 m: lengths .* metres"),
        ({"steps": ("5e-5", "1e-4")}, "pixels of 0.05 x 0.1 mm: resample to squares"),
        ({"steps": ("-5e-5", "-5e-5")}, "pixels of -0.05 x -0.05 mm"),
        ({"sizes": LAYERS}, "contains a surface of 2 layers, not a surface of one layer"),
        ({"sizes": LAYERS.replace(">2<", ">1<"), "feature": "PRF"}, "contains a profile, not a"),
        ({"data": SHORTS[:-1]}, "is not X3P: .* holds 11 bytes"),
        ({"more": ROTATED}, "not on an upright grid"),
        ({"kind": "A"}, "not on an upright grid"),
        ({"sizes": HUGE, "steps": ("1e-5", "1e-5")}, "an image of 30000 x 30000 pixels"),
        ({"z": ("I", "I", "1", "")}, "is not X3P: CZ: the z axis must be absolute"),
        ({"z": ("A", "D", "1", ""), "data": DOUBLES}, "heights of more than 1e38 mm"),
        ({"z": ("A", "X", "1", "")}, "is not X3P: CZ: unknown DataType 'X'"),
        ({"extra": {"more": bytes(17 << 20)}}, "contains a file that is larger than its heights"),
    ],
)  # fmt: skip
def test_files_of_other_programs_that_are_refused(
    tmp_path: Path, change: dict, message: str
) -> None:
    path = foreign(tmp_path / "a.x3p", **change)
    with pytest.raises(DataError, match=message) as refused:
        read_x3p(path)
    assert str(refused.value).startswith(f"{path}: not a readable X3P file: ")
    assert "\n" not in str(refused.value)


def test_damaged_files(tmp_path: Path) -> None:
    write_x3p(tmp_path / "a.x3p", RISING, 0.05)
    whole = (tmp_path / "a.x3p").read_bytes()
    half = whole[: len(whole) // 2]
    for data in (b"", b"PK", whole[:-30], half, whole.replace(b"main", b"niam")):
        (tmp_path / "b.x3p").write_bytes(data)
        with pytest.raises(DataError, match="not a readable X3P file: is not X3P"):
            read_x3p(tmp_path / "b.x3p")
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("main.xml", bytes(17 << 20))
    (tmp_path / "b.x3p").write_bytes(buffer.getvalue())
    with pytest.raises(DataError, match="has more than 16 MB"):
        read_x3p(tmp_path / "b.x3p")
    with pytest.raises(MissingPathError, match="no such file"):
        read_x3p(tmp_path / "c.x3p")


@pytest.mark.parametrize(
    ("height", "pixel_mm", "message"),
    [
        (RISING.astype(np.float64), 0.05, "heights are a float32 array"),
        (RISING[0], 0.05, "heights are a float32 array"),
        (np.full((2, 2), np.inf, np.float32), 0.05, "without infinity"),
        (np.full((2, 2), np.nan, np.float32), 0.05, "there is no height"),
        (RISING, 0.0, "more than 0 mm: 0.0"),
        (RISING, np.nan, "more than 0 mm: nan"),
    ],
)
def test_what_cannot_be_written(
    tmp_path: Path, height: np.ndarray, pixel_mm: float, message: str
) -> None:
    with pytest.raises(DataError, match=message):
        write_x3p(tmp_path / "a.x3p", height, pixel_mm)
    with pytest.raises(DataError, match="the suffix must be"):
        write_x3p(tmp_path / "a.sur", RISING, 0.05)
    with pytest.raises(DataError, match="character that XML cannot hold"):
        write_x3p(tmp_path / "a.x3p", RISING, 0.05, origin=X3pOrigin(comment="\x00"))
    assert not list(tmp_path.iterdir())
