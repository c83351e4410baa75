"""Errors in scene files are reported in one line that names the table and the key."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from acquisition import (
    DataError,
    MissingPathError,
    StorageError,
    write_lights,
)
from simulator import dome_lights, read_scene, scene_named, write_scene
from simulator.shapes import Plane


@pytest.mark.parametrize(
    ("text", "words"),
    [
        pytest.param("ambiant = 0.1", ["ambiant", "ambient"], id="unknown key"),
        pytest.param("ambient = 'much'", ["ambient"], id="text for a number"),
        pytest.param("ambient = nan", ["ambient"], id="not a number"),
        pytest.param("seed = -1", ["seed"], id="negative seed"),
        pytest.param("[object", ["TOML"], id="not TOML"),
        pytest.param("ambient = 2", ["ambient", "0..1"], id="too much ambient light"),
        pytest.param("[object]\nradius_mm=5", ["[object]", "kind", "coin"], id="no kind"),
        pytest.param("[object]\nkind='con'", ["[object]", "'con'", "coin"], id="unknown kind"),
        pytest.param("[object]\nkind=3", ["[object]", "3", "coin"], id="kind of another type"),
        pytest.param("[object]\nkind=['coin']", ["[object]", "coin"], id="kind as a list"),
        pytest.param("[object]\nkind='coin'", ["[object]", "radius_mm"], id="missing key"),
        pytest.param(
            "[object]\nkind='coin'\nradius_mm=-5", ["[object]", "radius_mm", "-5"],
            id="negative radius",
        ),
        pytest.param(
            "[object]\nkind='coin'\nradius_mm=5\nreleif_mm=1", ["[object]", "releif_mm"],
            id="unknown key of a kind",
        ),
        pytest.param(
            "[object]\nkind='mesh'\nfile='no.obj'\nradius_mm=5", ["[object]", "no.obj"],
            id="missing mesh",
        ),
        pytest.param(
            "[object]\nkind='mesh'\nfile='points.ply'\nradius_mm=5", ["[object]", "points.ply"],
            id="mesh without faces",
        ),
        pytest.param(
            "[[spheres]]\ncentre_mm=[0,0,5]\nradius_mm=5\n[[spheres]]\ncentre_mm=[0,9]\nradius_mm=1",
            ["[spheres.1]", "centre_mm"], id="sphere with two coordinates",
        ),
        pytest.param(
            "[[spheres]]\ncentre_mm=[0,0,5]\nradius_mm=-5", ["[spheres.0]", "-5"],
            id="sphere of negative radius",
        ),
        pytest.param(
            "[object]\nkind='plane'\nradius_mm=50\n[[spheres]]\ncentre_mm=[9,0,5]\nradius_mm=5",
            ["sphere 0", "overlaps"], id="sphere in the object",
        ),
        pytest.param(
            "[lights]\nkind='listed'\npositions_mm=[[0,100,-5]]", ["LED L00", "below"],
            id="LED below the surface",
        ),
        pytest.param("[lights]\nkind='ring'\ncount=0", ["[lights]", "0 LEDs"], id="no lights"),
        pytest.param("[lights]\nkind='dome'\nspread=0.5", ["[lights]", "spread"], id="wide spread"),
        pytest.param("[lights]\nkind='file'\nfile='bad.json'", ["bad.json"], id="bad lights"),
        pytest.param("[lamps]\nflicker=2", ["[lamps]", "flicker"], id="flicker"),
        pytest.param("[sensor]\nbit_depth=40", ["[sensor]", "bits"], id="bit depth"),
        pytest.param("[sensor]\niso=100", ["[sensor]", "iso"], id="unknown key of the sensor"),
        pytest.param("[lens]\nkind='perspective'\nwidth=0", ["[lens]"], id="zero-size image"),
        pytest.param(
            "[lens]\nkind='perspective'\nworking_distance_mm=-1", ["[lens]", "working_distance_mm"],
            id="negative distance",
        ),
        pytest.param(
            "[lens]\nkind='perspective'\nworking_distance_mm=8\n[object]\nkind='coin'\nradius_mm=50",
            ["camera", "inside the object"], id="camera inside the object",
        ),
    ],
)  # fmt: skip
def test_errors_are_reported_in_one_line(write, tmp_path, text, words):
    (tmp_path / "bad.json").write_text("{}", encoding="utf-8")
    trimesh.PointCloud(np.eye(3)).export(tmp_path / "points.ply")
    path = write(text)
    with pytest.raises(DataError) as caught:
        read_scene(path)
    line = str(caught.value)
    assert line.startswith(str(path))
    assert "\n" not in line.strip()
    for word in words:
        assert word in line


def test_the_number_of_lights_from_a_file_is_fixed(write, tmp_path):
    write_lights(tmp_path / "l.json", dome_lights(4))
    path = write("[lights]\nkind='file'\nfile='l.json'\n")
    with pytest.raises(DataError, match=r"\[lights\]"):
        read_scene(path, leds=5)


def test_a_missing_file_is_reported(tmp_path):
    with pytest.raises(MissingPathError, match=r"nowhere\.toml"):
        read_scene(tmp_path / "nowhere.toml")


def test_a_missing_folder_is_reported(tmp_path):
    with pytest.raises(StorageError, match="nowhere"):
        write_scene(tmp_path / "nowhere" / "scene.toml", scene_named("coin", leds=1))


def test_a_custom_object_cannot_be_written(tmp_path):
    class Hill(Plane):
        pass

    scene = replace(scene_named("coin", leds=1), body=Hill(40.0))
    with pytest.raises(DataError, match="Hill"):
        write_scene(tmp_path / "scene.toml", scene)
    assert list(tmp_path.iterdir()) == []


def test_errors_in_clutter_and_relief_name_the_table(write):
    for text, message in (
        ("[[clutter]]\nkind = 'cone'", "clutter.0.*ball, box"),
        ("[[clutter]]\nkind = 'box'\nplace_mm = [0, 0]", "clutter.0.*size_mm"),
        ("[relief]\nkind = 'coin'", "relief.*noise, textile"),
    ):
        with pytest.raises(DataError, match=message):
            read_scene(write(text))
