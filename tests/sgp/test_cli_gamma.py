"""``--gamma``: its values, its notice and record, and real captures saved as JPEGs."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from acquisition import (
    LINEAR,
    SRGB,
    Session,
    angle_deg,
    downscale,
    read_image,
    read_lights,
    read_source,
)
from acquisition import write_png as save
from processing import read_normals
from tests.quick_sample import quick
from tests.real_data import DATA, needs_data
from tests.sgp.conftest import FINE, ball, photographed


@pytest.fixture
def photographs(tmp_path: Path) -> Path:
    return photographed(tmp_path / "ball", 0.7)


def record(path: Path) -> dict:
    return json.loads(path.read_text(encoding="utf-8"))


CURVE = "sample,light\n" + "".join(
    f"{k},{v:.8f}\n" for k, v in enumerate(255 * SRGB.light(np.arange(256) / 255))
)


@pytest.mark.parametrize(
    ("option", "kind", "error_deg"),
    [
        pytest.param([], "srgb", 1.0, id="default"),
        pytest.param(["--gamma", "auto"], "srgb", 1.0, id="auto", marks=pytest.mark.slow),
        pytest.param(["--gamma", "sRGB"], "srgb", 1.0, id="srgb"),
        pytest.param(["--gamma", "2.2"], "power", 2.0, id="2.2"),
        pytest.param(["--gamma", "curve.csv"], "table", 1.0, id="file"),
    ],
)
@pytest.mark.parametrize("command", quick(["normals", "run"], every=2))
def test_photographs_give_the_normals_of_the_ball(
    sgp, photographs, tmp_path, monkeypatch, command, option, kind, error_deg
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "curve.csv").write_text(CURVE)
    answer = sgp(command, "ball", "--lights", "lights.json", *option, "--out", "out").ok()
    line = "note: ball: the samples are read as sRGB (8-bit JPEG without colour metadata)"
    assert (line in answer.err.splitlines()) == (option in ([], ["--gamma", "auto"]))
    assert "only by" not in answer.err
    names = ["normals.json"] if command == "normals" else ["summary.json", "surface/surface.json"]
    for name in names:
        parameters = record(tmp_path / "out" / name)["parameters"]
        assert parameters["gamma"] == (option[-1] if option else "auto")
        assert parameters["transfer"]["kind"] == kind
    inputs = record(tmp_path / "out" / names[0])["inputs"]
    assert ("curve.csv" in inputs) == (kind == "table")
    found = read_normals(tmp_path / "out" / ("normals" if command == "run" else "")).normal_map
    normals, mask = ball()
    error = angle_deg(found.normals[mask & found.mask], normals[mask & found.mask])
    assert np.median(error) < error_deg


def test_a_wrong_curve_is_a_warning_with_both_figures(sgp, photographs, tmp_path) -> None:
    out = tmp_path / "out"
    words = ["normals", photographs, "--lights", tmp_path / "lights.json", "--gamma", "linear"]
    answer = sgp(*words, "--out", out, "--json").ok()
    (notice,) = [n for n in json.loads(answer.out)["notices"] if "curve" in n["code"]]
    assert (notice["code"], notice["severity"]) == ("transfer-curve-doubtful", "warning")
    assert "read as linear, the images deviate" in notice["text"]
    assert notice["text"].count("%") == 2
    assert notice["text"].endswith("state the transfer curve: sRGB (--gamma srgb)")


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("nan", "nan is not a finite number"),
        ("inf", "inf is not a finite number"),
        ("0", "0 is not within 0.1 to 10"),
        ("-2.2", "-2.2 is not within 0.1 to 10"),
        ("11", "11 is not within 0.1 to 10"),
        ("rec709", "rec709 is not a number, auto, srgb, linear or a file"),
        ("nowhere.csv", "nowhere.csv is not a number, auto, srgb, linear or a file"),
        ("9" * 5000, "is not"),
    ],
)
@pytest.mark.parametrize(
    "command", ["normals", "run", "calibrate spheres", "calibrate intensities", "capture import"]
)
def test_values_that_are_refused(sgp, tmp_path, monkeypatch, command, value, said) -> None:
    monkeypatch.chdir(tmp_path)
    lights = ["--lights=."] if command == "calibrate intensities" else []
    line = sgp(*command.split(), ".", *lights, "--out=o.json", f"--gamma={value}").error_line(2)
    assert said in line
    assert len(line) < 300
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_not_a_curve(sgp, photographs, tmp_path) -> None:
    (tmp_path / "curve.csv").write_text("0,0\n1,1\n0.5,3\n")
    line = sgp(
        "normals", photographs, "--lights", tmp_path / "lights.json", "--out", tmp_path / "out",
        "--gamma", tmp_path / "curve.csv",
    ).error_line(4)  # fmt: skip
    assert "curve.csv: a table of a transfer curve increases in both columns" in line
    assert not (tmp_path / "out").exists()


def test_an_imported_session_keeps_the_curve(sgp, photographs, tmp_path) -> None:
    session, lights = tmp_path / "session", tmp_path / "lights.json"
    answer = sgp(
        "capture", "import", photographs, "--lights", lights, "--out", session, "--json"
    ).ok()
    assert "transfer-curve" in answer.codes()
    assert Session.open(session).transfer == SRGB
    assert sgp("normals", session, "--out", tmp_path / "a").code == 0
    assert sgp("normals", photographs, "--lights", lights, "--out", tmp_path / "b").code == 0
    one, other = (read_normals(tmp_path / name).normal_map.normals for name in "ab")
    np.testing.assert_array_equal(one, other)
    second = tmp_path / "second"
    words = ["--lights", lights, "--gamma", "linear", "--out", second]
    assert sgp("capture", "import", photographs, *words).code == 0
    assert Session.open(second).transfer == LINEAR


def test_spheres_record_the_curve(sgp, tmp_path) -> None:
    folder = tmp_path / "chrome"
    folder.mkdir()
    rows, columns = np.mgrid[:80, :80]
    for index in range(4):
        inside = (rows - 40) ** 2 + (columns - 40) ** 2 < 900
        spot = (rows - 34 - 4 * (index % 2)) ** 2 + (columns - 34 - 4 * (index // 2)) ** 2 < 6
        image = np.where(spot, 250, np.where(inside, 60, 10)).astype(np.uint8)
        cv2.imwrite(str(folder / f"c.{index}.jpg"), image, FINE)
    out = tmp_path / "lights.json"
    answer = sgp("calibrate", "spheres", folder, "--sphere", "40,40,30", "--out", out).ok()
    assert "the samples are read as sRGB" in answer.err
    parameters = record(out)["provenance"]["parameters"]
    assert (parameters["gamma"], parameters["transfer"]) == ("auto", {"kind": "srgb"})


def saved(source: Path, folder: Path, suffix: str) -> Path:
    """Save the images of a capture as 8-bit files with the sRGB curve."""
    folder.mkdir()
    for path in source.glob(f"{source.name}.*.tga"):
        pixels = read_image(path)
        if not path.stem.endswith("mask"):
            pixels = np.rint(255 * SRGB.samples(pixels / 255)).astype(np.uint8)
            cv2.imwrite(str(folder / f"{path.stem}.{suffix}"), pixels[..., ::-1], FINE)
        else:
            save(folder / "mask.png", pixels)
    return folder


@pytest.mark.slow
@needs_data
def test_display_ready_photographs_of_buddha_agree_with_its_linear_images(
    sgp, uw_lights, tmp_path
) -> None:
    """With no option given; read as linear, the same files are 14.7 degrees off."""
    buddha = DATA / "uw" / "buddha"
    images = saved(buddha, tmp_path / "buddha", "jpg")
    for name, source, options in (
        ("linear", buddha, []),
        ("photographs", images, []),
        ("wrong", images, ["--gamma", "linear"]),
    ):
        out = tmp_path / name
        codes = sgp(
            "normals",
            source,
            "--lights",
            uw_lights,
            *options,
            "--downscale",
            2,
            "--out",
            out,
            "--json",
        ).codes()
        assert ("transfer-curve-doubtful" in codes) == (name == "wrong")
    truth = read_normals(tmp_path / "linear").normal_map
    error = {}
    for name in ("photographs", "wrong"):
        found = read_normals(tmp_path / name).normal_map
        both = truth.mask & found.mask
        assert both.sum() > 0.99 * truth.mask.sum()
        error[name] = angle_deg(truth.normals[both], found.normals[both]).mean()
    assert error["photographs"] < 1.5
    assert error["wrong"] > 10


# Real captures at half of their size: as they are, as PNGs without metadata, and as JPEGs, which
# count as sRGB.
SAVED = {
    None: ("buddha", "cat", "gray"),
    "png": ("buddha", "cat", "gray"),
    "jpg": ("cat", "gray"),
}


@needs_data
@pytest.mark.parametrize(
    ("name", "suffix"),
    [
        pytest.param(
            name, suffix, marks=[] if (name, suffix) == ("cat", "jpg") else pytest.mark.slow
        )
        for suffix, names in SAVED.items()
        for name in names
    ],
)
def test_only_wrong_curves_of_real_captures_are_doubted(uw_lights, tmp_path, name, suffix) -> None:
    from processing import reconstruct

    folder = DATA / "uw" / name
    if suffix is not None:
        folder = saved(folder, tmp_path / name, suffix)
    source = downscale(read_source(folder, lights=read_lights(uw_lights)), 2)
    found = reconstruct(source, surface=False).warnings
    assert ("transfer-curve-doubtful" in [notice.code for notice in found]) == (suffix == "png")


@needs_data
@pytest.mark.slow
@pytest.mark.parametrize("name", ["catPNG", "bearPNG"])
def test_diligent_is_linear_without_a_word(name) -> None:
    from processing import reconstruct

    source = read_source(DATA / "diligent" / name)
    assert source.transfer == LINEAR
    found = reconstruct(downscale(source, 2), surface=False).warnings
    assert not [notice for notice in found if "curve" in notice.code]
