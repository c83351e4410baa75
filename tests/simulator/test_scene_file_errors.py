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
        ("ambiant = 0.1", ["ambiant", "ambient"]),
        ("ambient = 'much'", ["ambient"]),
        ("ambient = nan", ["ambient"]),
        ("seed = -1", ["seed"]),
        ("[object", ["TOML"]),
        ("ambient = 2", ["ambient", "0..1"]),
        ("[object]\nradius_mm=5", ["[object]", "kind", "coin"]),
        ("[object]\nkind='con'", ["[object]", "'con'", "coin"]),
        ("[object]\nkind=3", ["[object]", "3", "coin"]),
        ("[object]\nkind=['coin']", ["[object]", "coin"]),
        ("[object]\nkind='coin'", ["[object]", "radius_mm"]),
        ("[object]\nkind='coin'\nradius_mm=-5", ["[object]", "radius_mm", "-5"]),
        ("[object]\nkind='coin'\nradius_mm=5\nreleif_mm=1", ["[object]", "releif_mm"]),
        ("[object]\nkind='mesh'\nfile='no.obj'\nradius_mm=5", ["[object]", "no.obj"]),
        ("[object]\nkind='mesh'\nfile='points.ply'\nradius_mm=5", ["[object]", "points.ply"]),
        (
            "[[spheres]]\ncentre_mm=[0,0,5]\nradius_mm=5\n[[spheres]]\ncentre_mm=[0,9]\nradius_mm=1",
            ["[spheres.1]", "centre_mm"],
        ),
        ("[[spheres]]\ncentre_mm=[0,0,5]\nradius_mm=-5", ["[spheres.0]", "-5"]),
        (
            "[object]\nkind='plane'\nradius_mm=50\n[[spheres]]\ncentre_mm=[9,0,5]\nradius_mm=5",
            ["sphere 0", "overlaps"],
        ),
        ("[[clutter]]\nkind='cone'", ["[clutter.0]", "ball, box"]),
        ("[[clutter]]\nkind='box'\nplace_mm=[0,0]", ["[clutter.0]", "size_mm"]),
        ("[relief]\nkind='coin'", ["[relief]", "noise, textile"]),
        ("[lights]\nkind='listed'\npositions_mm=[[0,100,-5]]", ["LED L00", "below"]),
        ("[lights]\nkind='ring'\ncount=0", ["[lights]", "0 LEDs"]),
        ("[lights]\nkind='dome'\nspread=0.5", ["[lights]", "spread"]),
        ("[lights]\nkind='file'\nfile='bad.json'", ["bad.json"]),
        # Excessive values are refused before anything is built.
        ("[lights]\nkind='ring'\ncount=2147483648", ["at most 4096"]),
        ("[lights]\nkind='dome'\ncount=2147483648", ["at most 4096"]),
        ("[lens]\nkind='perspective'\nwidth=2147483648", ["maximum"]),
        ("[object]\nkind='noise'\nradius_mm=1e300", ["than 1e+12"]),
        ("[[spheres]]\nradius_mm=1\ncentre_mm=[1e300,0,0]", ["1e+12"]),
        ("ambient = 1e300", ["ambient"]),
        ("seed = " + "9" * 4301, ["digits"]),
        ("object = " + "[" * 20_000, ["nested"]),
        ("object = " + "{a = " * 20_000, ["nested"]),
        ("[object]\nkind='mesh'\nradius_mm=1\nfile='" + "a" * 300 + "'", ["no such file"]),
        ("[lens]\nkind='file'\nfile='/dev/zero'", ["no such file"]),
        ("[lamps]\nflicker=2", ["[lamps]", "flicker"]),
        ("[sensor]\nbit_depth=40", ["[sensor]", "bits"]),
        ("[sensor]\niso=100", ["[sensor]", "iso"]),
        ("[lens]\nkind='perspective'\nwidth=0", ["[lens]"]),
        ("[lens]\nkind='perspective'\nworking_distance_mm=-1", ["[lens]", "working_distance_mm"]),
        (
            "[lens]\nkind='perspective'\nworking_distance_mm=8\n[object]\nkind='coin'\nradius_mm=50",
            ["camera", "inside the object"],
        ),
    ],
)
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
