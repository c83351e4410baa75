"""Files of lights: golden files, .lp files of other programs, and refusals that name the line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from acquisition import DataError, Lights, MissingPathError, StorageError, read_lights, write_lights
from tests.cases import cases
from tests.real_data import DATA, needs_data

GOLDEN_NEAR = """\
{
 "format": "sgp-lights",
 "version": 1,
 "lights": [
  {"id": "L00", "position_mm": [0.0, 30.0, 40.0], "intensity": [1.0, 2.0, 3.0], \
"axis": [0.0, 0.0, -1.0], "mu": 0.5},
  {"id": "L07", "position_mm": [-100.0, 0.25, 300.0], "intensity": [1.0, 1.0, 1.0], \
"axis": [0.0, 0.6, -0.8], "mu": 1.0}
 ],
 "provenance": {"method": "two spheres", "residual_deg": 0.1}
}
"""
GOLDEN_DISTANT = """\
{
 "format": "sgp-lights",
 "version": 1,
 "lights": [
  {"id": "chrome.0", "direction": [0.6, 0.0, 0.8], "intensity": [1.0, 1.0, 1.0]}
 ],
 "provenance": {}
}
"""


def near_lights() -> Lights:
    return Lights(
        positions_mm=np.array([[0, 30, 40], [-100, 0.25, 300]]),
        intensities=np.array([[1, 2, 3], [1, 1, 1]]),
        axes=np.array([[0, 0, -2], [0, 3, -4]]),
        mu=np.array([0.5, 1]),
        ids=("L00", "L07"),
    )


def put(path: Path, content: str | bytes) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def test_golden_lights_json(tmp_path: Path) -> None:
    path = tmp_path / "lights.json"
    write_lights(path, near_lights(), {"method": "two spheres", "residual_deg": 0.1})
    assert path.read_text() == GOLDEN_NEAR
    lights = read_lights(path)
    assert lights.ids == ("L00", "L07")
    np.testing.assert_array_equal(lights.positions_mm, [[0, 30, 40], [-100, 0.25, 300]])
    np.testing.assert_array_equal(lights.intensities, [[1, 2, 3], [1, 1, 1]])
    np.testing.assert_array_equal(lights.axes, [[0, 0, -1], [0, 0.6, -0.8]])
    np.testing.assert_array_equal(lights.mu, [0.5, 1])
    write_lights(path, Lights(directions=np.array([[3, 0, 4]]), ids=("chrome.0",)))
    assert path.read_text() == GOLDEN_DISTANT
    np.testing.assert_array_equal(read_lights(path).directions, [[0.6, 0, 0.8]])


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), near=st.booleans())
def test_lights_json_keeps_every_digit(tmp_path: Path, data: st.DataObject, near: bool) -> None:
    count = data.draw(st.integers(1, 5))
    vector = st.tuples(st.floats(-900, 900), st.floats(-900, 900), st.floats(1, 900))
    vectors = np.array(data.draw(st.lists(vector, min_size=count, max_size=count)))
    strengths = data.draw(st.lists(st.floats(1e-3, 1e3), min_size=count, max_size=count))
    lights = Lights(
        positions_mm=vectors if near else None,
        directions=None if near else vectors,
        intensities=np.array(strengths),
        mu=np.arange(count) / 3 if near else None,
    )
    path = tmp_path / "lights.json"
    write_lights(path, lights)
    back = read_lights(path)
    np.testing.assert_array_equal(back.intensities, lights.intensities)
    if near:
        np.testing.assert_array_equal(back.positions_mm, vectors)
        np.testing.assert_array_equal(back.mu, lights.mu)
    # Unit vectors are normalised again on reading, which may change the last bit.
    np.testing.assert_allclose(back.unit_directions, lights.unit_directions, rtol=0, atol=3e-16)


def changed(**changes: object) -> str:
    light = json.loads(GOLDEN_NEAR)["lights"][0]
    light.update(changes)
    light = {key: value for key, value in light.items() if value is not None}
    other = {"id": "L01", "position_mm": [1, 2, 3], "axis": [0, 0, -1]}
    return json.dumps({"format": "sgp-lights", "version": 1, "lights": [other, light]})


@cases(
    ("content", "names", "vectors"),
    {
        "plain": (
            "2\na.jpg 0 0 1\nb.jpg 0.6 0 0.8\n",
            ("a.jpg", "b.jpg"),
            [[0, 0, 1], [0.6, 0, 0.8]],
        ),
        "BOM, CRLF, tabs, blank lines, not unit": (
            b"\xef\xbb\xbf2\r\na.jpg\t0\t0\t1\r\n\r\nb.jpg 3 0 4\r\n\r\n",
            ("a.jpg", "b.jpg"),
            [[0, 0, 1], [0.6, 0, 0.8]],
        ),
        "Windows path, spaces, decimal commas, no final newline": (
            "1\nC:\\My Captures\\owl 2\\img 01.jpg 0,0 0,6 0,8",
            ("img 01.jpg",),
            [[0, 0.6, 0.8]],
        ),
        "posix path, exponent, negative": (
            "1\n/home/x/a b/c.0.tga -1e-1 0 0\n",
            ("c.0.tga",),
            [[-1, 0, 0]],
        ),
        "comment, name with #": ("# dome one\n1\n#1.jpg 0 0 1\n", ("#1.jpg",), [[0, 0, 1]]),
        "Latin-1 name": (b"1\nM\xfcller.jpg 0 0 1\n", ("M\xfcller.jpg",), [[0, 0, 1]]),
    },
)
def test_lp_files_of_other_programs(
    tmp_path: Path, content: str | bytes, names: tuple[str, ...], vectors: list[list[float]]
) -> None:
    lights = read_lights(put(tmp_path / "dome.LP", content))
    assert lights.ids == names
    np.testing.assert_allclose(lights.directions, vectors, atol=1e-15)


def test_lp_written(tmp_path: Path) -> None:
    path = tmp_path / "a.lp"
    write_lights(path, near_lights())
    # (-100, 0.25, 300) is sqrt(100000) sqrt(1 + 6.25e-7) long.
    assert path.read_text() == (
        "2\nL00 0.000000000 0.600000000 0.800000000\nL07 -0.316227667 0.000790569 0.948683002\n"
    )
    np.testing.assert_allclose(
        read_lights(path).directions, near_lights().unit_directions, atol=1e-9
    )


@cases(
    "text",
    {
        "rows": "0 0 1\n0.6 0 0.8\n",
        "count first": "2\n0 0 1\n3 0 4",
        "commas between": "0.0, 0.0, 1.0\r\n0.6,0.0,0.8\r\n",
        "decimal commas": "0 0 1\n0,6 0 0,8\n",
        "whole numbers between commas": "0,0,1\n3,0,4\n",
        "spaces before commas": "0 ,0 ,1\n3 ,0 ,4\n",
        "semicolons": "0;0;1\n0,6;0;0,8\n",
        "commas with spaces and decimal commas": "0, 0, 1\n0,6, 0, 0,8\n",
        "tabs and a heading": "x\ty\tz\n0\t0\t1\n0.6\t0\t0.8\n",
        "comments": "# lights of 3 May\n0 0 1\n% inner ring\n3 0 4\n",
        "other columns": "# light_z, light_x, light_y\n1,0,0\n0.8,0.6,0\n",
    },
)
def test_tables_of_directions(tmp_path: Path, text: str) -> None:
    lights = read_lights(put(tmp_path / "lights.txt", text))
    assert lights.ids == ("L00", "L01")
    np.testing.assert_allclose(lights.directions, [[0, 0, 1], [0.6, 0, 0.8]])


@cases(
    ("text", "names", "strengths", "assumed"),
    {
        "quoted": ('"a 1.png","0","0","1"\nb.png,0.6,0,0.8', ("a 1.png", "b.png"), 1, ""),
        "rows counted": ("1;a.png;0;0;1\n2;b;0,6;0;0,8", ("a.png", "b"), 1, ""),
        "numbers of images": ("3 0 0 1\n1 0.6 0 0.8", ("3", "1"), 1, ""),
        "name of two words": ("img 1 0 0 1\nimg 2 3 0 4", ("img 1", "img 2"), 1, ""),
        "stated": ("file,x,y,z,intensity\na,0,0,1,30\nb,0.6,0,0.8,7", ("a", "b"), [30, 7], ""),
        "own column of names": ("Bild;Lx;Ly;Lz;\na;0;0;1\nb;0.6;0;0.8\n;;;", ("a", "b"), 1, ""),
        "unused": ("led;file;x;y;z\n7;a;0;0;1\n8;b;3;0;4", ("a", "b"), 1, "not used: led"),
        "no names": ("0 0 1 1.2\n0.6 0 0.8 .8", ("L00", "L01"), [1.2, 0.8], "as intensity"),
        "after a suffix": (
            "a.png 0 0 1 1.2\nb.png 3 0 4 .8",
            ("a.png", "b.png"),
            [1.2, 0.8],
            "as intensity",
        ),
        "whole numbers of one length": (
            "img_1 0 0 1 1.2\nimg_2 1 0 0 .8",
            ("img_1", "img_2"),
            [1.2, 0.8],
            "as intensity",
        ),
        "radius": ("a.png 0 0 1 450\nb.png 3 0 4 450", ("a.png", "b.png"), 1, "not used"),
    },
)
def test_rows_with_names_or_a_further_number(
    tmp_path: Path, text: str, names: tuple[str, ...], strengths: list[float] | int, assumed: str
) -> None:
    lights = read_lights(put(tmp_path / "lights.csv", text))
    assert lights.ids == names
    np.testing.assert_allclose(np.asarray(lights.intensities)[:, 0], strengths)
    texts = [each.text for each in lights.warnings if each.code == "light-column-assumed"]
    assert [text for text in texts if assumed in text] == texts
    assert len(texts) == bool(assumed)


@cases(
    ("text", "lengths"),
    {
        "positions": ("300 0 0\n0 0 500\n", "300 to 500 long"),
        "dome": ("450 0 0\n0 0 450\n", "450 long"),
        "rounded": ("0.57 0.57 0.58\n0.71 0 0.71\n", ""),
        "whole numbers": ("1 0 1\n0 0 1\n", ""),
    },
)
def test_lengths_that_are_not_used_are_noted(tmp_path: Path, text: str, lengths: str) -> None:
    notices = read_lights(put(tmp_path / "lights.txt", text)).warnings
    assert [notice.code for notice in notices] == ["light-lengths-unused"] * bool(lengths)
    assert all(lengths in notice.text for notice in notices)


REFUSED = {
    "lights.json": {
        "empty": ("", "JSON"),
        "cut short": ("{", "JSON"),
        "a list": ("[]", "valid dictionary|object"),
        "version": (
            changed().replace('"version": 1', '"version": 3'),
            "version 3 of sgp-lights is unknown, this program reads 1 and 2",
        ),
        "no version": (changed().replace('"version": 1', '"version": true'), "True"),
        "format": (changed().replace("sgp-lights", "lights"), "format"),
        "unknown key": (changed(colour="red"), "unknown key 'lights.1.colour'"),
        "zero": (changed(position_mm=[0, 0, 0]), "light L00 is a zero vector"),
        "NaN": (changed(position_mm=[0, 0, 1e999]).replace("Infinity", "NaN"), "lights.1"),
        "text": (changed(position_mm=[0, "x", 1]), "lights.1.position_mm.1"),
        "two numbers": (changed(position_mm=[0, 1]), "lights.1.position_mm"),
        "no vector": (changed(position_mm=None), "either direction or"),
        "both vectors": (changed(direction=[0, 0, 1]), "either direction or"),
        "mixed": (changed(position_mm=None, direction=[0, 0, 1]), "L00 differs in kind"),
        "one axis missing": (changed(axis=None), "L00 differs .* give all lights an axis"),
        "same id": (changed(id="L01"), "L01 is listed twice"),
        "no light": (changed(intensity=[1, 0, 1]), "L00 has an intensity"),
        "negative mu": (changed(mu=-1), "lights.1.mu"),
        "none": ('{"format": "sgp-lights", "version": 1, "lights": []}', "lights"),
    },
    "a.lp": {
        "empty": ("", "empty"),
        "no lights": ("0\n", "line 1: the count is 0, but 0 lights follow"),
        "count missing": ("a.jpg 0 0 1\n", r"line 1: 'a\.jpg 0 0 1' is not a count"),
        "count too big": ("3\na.jpg 0 0 1\n", "line 1: the count is 3, but 1 light follows"),
        "count too small": ("1\na 0 0 1\nb 0 0 1\n", "line 1: the count is 1, but 2 lights follow"),
        "zero": ("2\na 0 0 1\n\nb 0 0 0\n", "line 4: a zero vector"),
        "NaN": ("1\na 0 nan 1\n", "line 2: a number is not finite"),
        "infinity": ("1\na 0 inf 1\n", "line 2: a number is not finite"),
        "text": ("1\na 0 up 1\n", "line 2: 'a 0 up 1' is not 'file x y z'"),
        "no name": ("1\n0 0 1\n", "line 2: '0 0 1' is not 'file x y z'"),
        "same name": ("2\na 0 0 1\na 0 1 1\n", "line 3: a is listed twice"),
    },
    "lights.txt": {
        "blank": ("\n", "empty"),
        "zero": ("0 0 1\n\n0 0 0\n", "line 3: a zero vector"),
        "two numbers": ("0 0 1\n0 0\n", "line 2: '0 0' is not three numbers"),
        "wrong count": ("3\n0 0 1\n", "line 1: '3' is not three numbers"),
        "heading": ("a b c\n0 0 1\n", "line 1: 'a b c' is not"),
        "line as it is": ("0,0,1\n1,0,up\n", "line 2: '1,0,up' is not three"),
        "NaN": ("0 0 1\nnan 0 1\n", "line 2: a number is not finite"),
    },
    "lights.csv": {
        "two commas": ("0,6,0,1,0,8\n", "line 1: '0,6,0,1,0,8' is not three"),
        "the same, named": ("a,0,6,0,1,0,8\n", "line 1: 'a,0,6,0,1,0,8' is not"),
        "angles": ("azimuth,elevation,radius\n10,20,1\n", "line 1: .* heading with x, y and z"),
        "short": ("x,y,z\n1,0\n", "line 2: '1,0' is not a row with 3 columns"),
        "only a heading": ("x,y,z\n", "line 1: 'x,y,z' is not followed by lights"),
        "one name missing": ("a 0 0 1\n0 1 1\n", "line 2: '0 1 1' has no name"),
        "undecided": ("0,0,1,1\n0,1,1,1\n1,0,1,1\n", "line 1: .* may belong"),
        "one without": ("a.png 0 0 1 1\nb.png 0 1 1\n", "line 2: .* as the lines"),
        "rgb": ("a.png 0 0 1 1 1 1\n", "line 1: 'a.png 0 0 1 1 1 1' is not"),
        "distance": ("a.png 0 0 1 1\nb.png 3 0 4 412\n", "line 2: .* number 412"),
        "negative": ("a.png 0 0 1 1\nb.png 3 0 4 -1\n", "line 2: .* number -1"),
    },
}


@cases(
    ("name", "text", "match"),
    {f"{name} {case}": (name, *row) for name in REFUSED for case, row in REFUSED[name].items()},
)
def test_files_are_refused_by_line_or_key(tmp_path: Path, name: str, text: str, match: str) -> None:
    path = put(tmp_path / name, text)
    with pytest.raises(DataError, match=match) as caught:
        read_lights(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def diligent(folder: Path, *, names: int = 2, strengths: str = "1 2 3\n4 5 6\n") -> Path:
    put(folder / "light_directions.txt", "0 0 1\n0.6 0 0.8\n")
    put(folder / "light_intensities.txt", strengths)
    put(folder / "filenames.txt", "".join(f"{i + 1:03d}.png\r\n" for i in range(names)))
    return folder


@pytest.mark.parametrize("name", ["", "light_directions.txt"])
def test_diligent_by_folder_or_file(tmp_path: Path, name: str) -> None:
    lights = read_lights(diligent(tmp_path) / name)
    assert lights.ids == ("001.png", "002.png")
    np.testing.assert_array_equal(lights.intensities, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_allclose(lights.directions, [[0, 0, 1], [0.6, 0, 0.8]])


def test_diligent_counts_must_match(tmp_path: Path) -> None:
    diligent(tmp_path, names=3)
    with pytest.raises(DataError, match=r"2 lights, but filenames\.txt in the same folder has 3"):
        read_lights(tmp_path)
    diligent(tmp_path, strengths="1 2 3\n")
    with pytest.raises(
        DataError, match=r"2 lights, but light_intensities\.txt in the same folder has 1"
    ):
        read_lights(tmp_path)
    diligent(tmp_path, strengths="1 2 3\n4 0 6\n")
    with pytest.raises(DataError, match=r"light_intensities\.txt line 2: an intensity that is"):
        read_lights(tmp_path)


def test_paths_without_lights(tmp_path: Path) -> None:
    with pytest.raises(MissingPathError, match="no such file"):
        read_lights(tmp_path / "lights.json")
    with pytest.raises(DataError, match=r"has no light_directions\.txt"):
        read_lights(tmp_path)
    (tmp_path / "folder.lp").mkdir()
    with pytest.raises(DataError, match=r"has no light_directions\.txt"):
        read_lights(tmp_path / "folder.lp")
    with pytest.raises(DataError, match="not a text file"):
        read_lights(put(tmp_path / "lights.txt", b"\x89PNG\0\0"))


def test_lights_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"written as \.json or \.lp"):
        write_lights(tmp_path / "lights.txt", near_lights())
    with pytest.raises(StorageError, match="No such file"):
        write_lights(tmp_path / "none" / "lights.json", near_lights())
    assert list(tmp_path.iterdir()) == []


@needs_data
def test_real_files_of_lights() -> None:
    shipped = read_lights(DATA / "uw" / "lights_shipped_unreliable.txt")
    assert len(shipped) == 12
    first = np.array([0.403259, 0.480808, 0.778592])
    np.testing.assert_allclose(shipped.unit_directions[0], first / np.linalg.norm(first))
    bear = read_lights(DATA / "diligent" / "bearPNG")
    assert len(bear) == 96
    assert bear.ids[0] == "001.png"
    np.testing.assert_allclose(np.asarray(bear.intensities)[0], [1.253, 1.6642, 2.2018])
