"""Rows of a scene that are rendered on their own are equal to those of the complete image."""

import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from acquisition import DataError, StorageError
from simulator import render, scene_named
from simulator.rendering import render_stored, rendering_bytes
from simulator.rendering.renderer import RowRenderer
from simulator.shapes import Ripples

# Bytes of memory for a few rows: the work of a rendering, and 4 images of 180 bytes a pixel.
FEW_ROWS = 2**27 + 12 * 48 * 180
MAPS = ("normals", "height_mm", "albedo", "mask", "sphere_masks", "shadows", "points_mm")


def scenes():
    coin = scene_named("coin", width=48, height=40, leds=3)
    spheres = scene_named("spheres", width=48, height=40, leds=3)
    optics = replace(coin.lens.optics, f_number=1.4, focus_mm=540.0)
    return {
        "blurred": coin,
        "sharp": scene_named("coin", width=48, height=40, leds=3, sharp=True),
        "mirrored lights": spheres,
        "mosaic in colour": replace(coin, lens=replace(coin.lens, cfa="RGGB")),
        "out of focus": replace(coin, lens=replace(coin.lens, optics=optics)),
        "relief of the board": replace(coin, relief=Ripples(150.0, 0.2, 9.0)),
    }


@pytest.mark.slow
def test_rows_are_equal_to_those_of_the_complete_image():
    for name, scene in scenes().items():
        whole, renderer = render(scene), RowRenderer(scene)
        for first in range(0, 40, 13):
            last = min(first + 13, 40)
            part, same = renderer.rows(first, last, lambda _: None), whole.rows(first, last)
            np.testing.assert_array_equal(part.planes, same.planes, name)
            np.testing.assert_array_equal(part.ambient, same.ambient, name)
            for field in MAPS:
                np.testing.assert_array_equal(
                    getattr(part.truth, field), getattr(same.truth, field), f"{name}: {field}"
                )


def test_a_stored_rendering_has_the_same_images_and_maps(tmp_path):
    scene, steps = scenes()["mirrored lights"], []
    whole = render(scene)
    report = {"on_progress": lambda _, done, total: steps.append((done, total))}
    with render_stored(scene, tmp_path, memory_bytes=FEW_ROWS, **report) as stored:
        assert list(tmp_path.iterdir()) == []
        assert len(steps) > 4
        assert steps[-1] == (40, 40)
        for led in (None, 0, 1, 2):
            np.testing.assert_array_equal(stored.plane(led)[:], whole.plane(led))
        assert stored.maps.keys() == whole.maps.keys()
        for name, values in whole.maps.items():
            np.testing.assert_array_equal(stored.maps[name][3:31], values[3:31], name)
        part, same = stored.truth_of(slice(7, 9)), whole.truth_of(slice(7, 9))
        for field in MAPS:
            np.testing.assert_array_equal(getattr(part, field), getattr(same, field), field)
        with pytest.raises(DataError, match="LED 3 is not in the scene, which has 3 LEDs"):
            stored.plane(3)


def test_too_little_memory_or_disk_is_refused_before_any_work(tmp_path, monkeypatch):
    scene = scenes()["blurred"]
    with pytest.raises(DataError, match=r"3 images of 48 pixels a row needs at least 135 MB"):
        render_stored(scene, tmp_path, memory_bytes=2**27)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1000))
    with pytest.raises(StorageError, match=r"needs 0 MB for temporary files, but 0 MB are"):
        render_stored(scene, tmp_path, memory_bytes=FEW_ROWS)
    assert list(tmp_path.iterdir()) == []
    monkeypatch.undo()
    with pytest.raises(StorageError, match="nowhere: cannot create a temporary folder"):
        render_stored(scene, tmp_path / "nowhere", memory_bytes=FEW_ROWS)


def test_memory_that_a_rendering_needs_grows_with_lights_and_pixels():
    sizes = [
        rendering_bytes(scene_named("coin", width=width, height=400, leds=leds))
        for width, leds in ((500, 4), (1000, 4), (1000, 36))
    ]
    assert np.diff(sizes).tolist() == [400 * 500 * (5 * 4 + 48), 400 * 1000 * 5 * 32]
