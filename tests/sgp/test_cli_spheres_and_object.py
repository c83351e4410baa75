"""``--spheres``: the lights come from chrome spheres next to the object."""

import json
import shutil

import numpy as np
import pytest

from acquisition import read_image, read_lights, write_png
from acquisition.values import led_id
from calibration import EstimateError
from processing import read_normals
from sgp import read_record
from tests.acquisition.dng_file import directory, tag
from tests.acquisition.image_bytes import chunk
from tests.calibration.spheres_and_object import (
    BALLS,
    OBJECT,
    OBJECT_RADIUS,
    RADIUS,
    directions,
    normals_of,
    write_recording,
)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recording")
    write_recording(folder)
    return folder


def angles_deg(a, b):
    cross = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.degrees(np.arctan2(cross, np.sum(a * b, axis=-1)))


def test_normals_with_the_lights_of_the_spheres(sgp, recording, tmp_path):
    out = tmp_path / "normals"
    result = sgp("normals", recording, "--spheres", "--out", out).ok()
    assert "8 light directions from 2 spheres" in result.out
    lights = read_lights(out / "lights.json")
    assert angles_deg(lights.directions, directions()).max() < 0.4
    assert (out / "lights.png").exists()
    normals, _ = normals_of(OBJECT, OBJECT_RADIUS)
    inside = normals_of(OBJECT, 0.7 * OBJECT_RADIUS)[1]  # lit by every light
    assert angles_deg(read_normals(out).normal_map.normals, normals)[inside].mean() < 0.5
    mask = read_image(out / "mask.png") > 0
    for ball in BALLS:
        assert not mask[normals_of(ball, RADIUS)[1]].any()
    record = read_record(out / "normals.json")
    assert record.parameters["spheres"] is True
    assert {"lights", "lights_png"} <= record.outputs.keys()


def test_a_radius_without_a_camera_gives_the_scale(sgp, recording, tmp_path):
    out = tmp_path / "normals"
    words = ("--spheres", "--radius-mm", 12, "--downscale", 2)
    result = sgp("normals", recording, *words, "--out", out, "--json").ok()
    assert "scale-from-spheres" in result.codes()
    assert read_lights(out / "lights.json").positions_mm is None
    # Of a pixel of the frames, as when it is stated.
    pixel = read_record(out / "normals.json").parameters["pixel_mm"]
    assert pixel == pytest.approx(12 / RADIUS, rel=0.01)


@pytest.mark.slow
def test_a_radius_and_the_focal_length_in_exif_give_the_distance(sgp, recording, tmp_path):
    """The images are orthographic: a lens of 1250 mm before a sensor of 36 mm is nearly so."""
    source, out = tmp_path / "source", tmp_path / "normals"
    shutil.copytree(recording, source)
    height, width = read_image(source / "L00.png").shape
    tags = [tag(37386, 5, (1250, 1)), tag(41989, 3, (1250,))]
    tags += [tag(40962, 3, (width,)), tag(40963, 3, (height,))]
    block = b"II*\0\x08\0\0\0" + directory(tags, 8)
    for path in source.glob("L*.png"):
        data = path.read_bytes()
        path.write_bytes(data[:33] + chunk(b"eXIf", block) + data[33:])
    words = ("--spheres", "--radius-mm", 12, "--downscale", 2)
    result = sgp("normals", source, *words, "--out", out, "--json").ok()
    assert {"scale-from-spheres", "camera-from-exif"} <= set(result.codes())
    lights = read_lights(out / "lights.json")
    assert lights.positions_mm is None
    assert angles_deg(lights.directions, directions()).max() < 0.4
    pixel = read_record(out / "normals.json").parameters["pixel_mm"]
    assert pixel == pytest.approx(12 / RADIUS, rel=0.01)
    # Lights at a distance need a scale.
    near = (source, "--lights", out / "lights.json", "--light-distance-mm", 900)
    line = sgp("normals", *near, "--out", tmp_path / "near").error_line(4)
    assert "give a camera with a working distance, or the size of a pixel" in line
    sgp("normals", *near, "--pixel-mm", pixel, "--out", tmp_path / "near").ok()


@pytest.mark.slow
def test_the_lights_are_those_of_calibrate(sgp, recording, tmp_path):
    """A region is cut after the calibration in complete images, without the excluded ones."""
    out = tmp_path / "result"
    words = ("--crop", "85,35,130,130", "--exclude", "L03")
    result = sgp("run", recording, "--spheres", *words, "--out", out, "--json").ok()
    assert json.loads(result.out)["outputs"]["lights"] == str(out / "lights.json")
    own = tmp_path / "own.json"
    words = ("--exclude", "L03", "--out", own)
    assert sgp("calibrate", "spheres", recording, *words).code == 0
    found, own = read_lights(out / "lights.json"), read_lights(own)
    np.testing.assert_array_equal(found.directions, own.directions)
    assert found.ids == own.ids
    assert len(found) == 7


def test_the_page_has_the_notices_about_the_spheres(sgp, recording, tmp_path):
    """The page is written before the record of the run, which alone has them."""
    source, out = tmp_path / "source", tmp_path / "result"
    shutil.copytree(recording, source)
    for path in source.iterdir():
        write_png(path, np.minimum(read_image(path).astype(int) * 2, 65535).astype(np.uint16))
    notices = sgp("run", source, "--spheres", "--out", out, "--json").codes()
    assert "highlights-saturated" in notices
    page = (out / "report.html").read_text()
    assert [code for code in notices if page.count(f"<code>{code}</code>") != 1] == []


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--spheres", "--lights", "{recording}/L00.png"), "--lights and --spheres both give"),
        (("--radius-mm", "12"), "--radius-mm is the radius of spheres: give --spheres as well"),
        (("--rig", "dome"), "give --lights rig, or --spheres"),
    ],
    ids=["both", "radius only", "rig only"],
)
@pytest.mark.parametrize("command", ["normals", "run", "inspect"])
def test_contradictions_are_refused(sgp, recording, tmp_path, command, words, text):
    words = [word.format(recording=recording) for word in words]
    out = () if command == "inspect" else ("--out", tmp_path / "out")
    assert text in sgp(command, recording, *words, *out).error_line(2)
    assert not (tmp_path / "out").exists()


def test_a_recording_without_spheres_is_refused_in_one_line(sgp, recording, tmp_path):
    words = ("--spheres", "--crop", "85,35,130,130", "--exclude", "L00-L07")
    result = sgp("normals", recording, *words, "--out", tmp_path / "out")
    assert result.code != 0
    assert result.err.count("\n") == 1


@pytest.mark.slow
def test_inspect_takes_the_lights_of_the_spheres(sgp, recording):
    assert "8 images, distant lights" in sgp("inspect", recording, "--spheres").ok().out


@pytest.mark.slow
def test_lights_that_contradict_the_rig_file_are_named(sgp, recording, tmp_path):
    rows = np.round(450 * directions()).tolist()
    rows[2], rows[5] = rows[5], rows[2]
    file = tmp_path / "rig.toml"
    file.write_text(f'name = "dome"\ndriver = "bench"\nleds = 8\nled_positions_mm = {rows}\n')
    result = sgp("inspect", recording, "--spheres", "--rig", file, "--json").ok()
    notices = [(one["code"], one["where"]) for one in json.loads(result.out)["notices"]]
    assert ("lights-swapped", "rig dome") in notices
    out = tmp_path / "normals"
    result = sgp("normals", recording, "--spheres", "--rig", file, "--out", out)
    assert "LED 2 and 5 are swapped" in " ".join(result.err.split())


@pytest.mark.parametrize("command", ["normals", "run", "inspect"])
def test_the_rig_file_decides_about_radius_and_distance(
    sgp, recording, tmp_path, monkeypatch, command
):
    """The decision itself is tested in test_cli_setup.py."""
    rows = np.round(450 * directions()).tolist()
    file = tmp_path / "rig.toml"
    file.write_text(f'name = "dome"\ndriver = "bench"\nleds = 8\nled_positions_mm = {rows}\n')
    given = {}

    def stop(stack, *, led_positions_mm, **_):
        given.update(led_positions_mm)
        raise EstimateError("stopped here")

    monkeypatch.setattr("calibration.calibrate_spheres", stop)
    out = () if command == "inspect" else ("--out", tmp_path / "out")
    words = (command, recording, "--spheres", *out)
    assert "stopped here" in sgp(*words, "--rig", file).err
    assert given == {led_id(i): tuple(row) for i, row in enumerate(rows)}
    given.clear()
    assert "stopped here" in sgp(*words).err
    assert not given


@pytest.mark.slow
def test_normals_are_nearly_as_good_as_with_a_separate_calibration(sgp, tmp_path):
    """Both without intensities: spheres next to the coin, and a recording of spheres alone.

    The balls next to the coin have 27 px radius, those alone 31 to 46 px. With the blur of a real
    lens, the ratio of seeds 0 to 2 is 1.03, 1.02 and .98; in sharp images .98, 1.13 and 1.05.
    """
    coin, alone = tmp_path / "coin", tmp_path / "spheres"
    for scene, out in (("coin-with-spheres", coin), ("spheres", alone)):
        assert sgp("simulate", scene, "--out", out).code == 0
    radii = [word for radius in (20, 20, 16, 14) for word in ("--radius-mm", radius)]
    lights = tmp_path / "lights.json"
    assert sgp("calibrate", "spheres", alone, *radii, "--out", lights).code == 0
    errors_deg = []
    for name, words in (
        ("own", ("--spheres", "--radius-mm", 12)),
        ("separate", ("--lights", lights)),
    ):
        answer = sgp("normals", coin, *words, "--out", tmp_path / name, "--json").ok()
        errors_deg.append(json.loads(answer.out)["metrics"]["mae_deg"])
    assert errors_deg[0] < 1.1 * errors_deg[1]
