"""Scene files with excessive values are refused in one line before anything is built."""

from __future__ import annotations

import pytest

from acquisition import DataError, MissingPathError
from simulator import read_scene


@pytest.mark.parametrize(
    ("text", "message"),
    [
        pytest.param('[lights]\nkind = "ring"\ncount = 2147483648', "at most 4096", id="ring"),
        pytest.param('[lights]\nkind = "dome"\ncount = 2147483648', "at most 4096", id="dome"),
        pytest.param('[lens]\nkind = "perspective"\nwidth = 2147483648', "maximum", id="lens"),
        pytest.param('[object]\nkind = "noise"\nradius_mm = 1e300', "than 1e.12", id="radius"),
        pytest.param("[[spheres]]\nradius_mm = 1\ncentre_mm = [1e300, 0, 0]", "1e.12", id="nested"),
        pytest.param("ambient = 1e300", "ambient", id="top"),
        pytest.param("seed = " + "9" * 4301, "digits", id="digits"),
        pytest.param("object = " + "[" * 20_000, "nested", id="arrays"),
        pytest.param("object = " + "{a = " * 20_000, "nested", id="tables"),
        pytest.param('[object]\nkind = "mesh"\nradius_mm = 1\nfile = "' + "a" * 300 + '"',
                     "no such file", id="long name"),
        pytest.param('[lens]\nkind = "file"\nfile = "/dev/zero"', "no such file", id="device"),
    ],
)  # fmt: skip
def test_refused(tmp_path, text, message):
    path = tmp_path / "scene.toml"
    path.write_text(text)
    with pytest.raises(DataError, match=message) as caught:
        read_scene(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_reported(tmp_path):
    with pytest.raises(MissingPathError):
        read_scene(tmp_path / "nowhere.toml")
