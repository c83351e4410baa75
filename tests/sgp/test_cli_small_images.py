"""Images and normal maps of a few pixels: each command succeeds, or says what is too small."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from acquisition import Lights, write_lights, write_mask, write_png
from processing import NormalMap, write_normals
from tests.quick_sample import quick


@pytest.fixture
def make(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Return a function that makes ``images`` and ``map``, square and of a size in pixels."""
    monkeypatch.chdir(tmp_path)

    def squares(size: int) -> None:
        lights = Lights(directions=[[1, 0, 2], [0, 1, 2], [-1, 0, 2], [0, -1, 2]])
        write_lights("lights.json", lights)
        y, x = np.meshgrid(np.linspace(0.5, -0.5, size), np.linspace(-0.5, 0.5, size))
        normals = NormalMap.from_vectors(np.dstack([x, y, np.ones_like(x)]))
        write_normals("map", normals)
        Path("images").mkdir()
        for i, light in enumerate(lights.unit_directions):
            shade = np.clip(normals.normals @ light, 0, 1)
            write_png(f"images/{i}.png", np.rint(40_000 * shade).astype(np.uint16))
        write_mask("images/mask.png", normals.mask)

    return squares


FILTER = "a shape filter with w={} has a window of {} pixels, larger than the normal map of {}: {}"


@pytest.mark.parametrize(
    ("size", "words", "complaint"),
    [
        (1, [], FILTER.format(5, 11, "1 x 1", "a map of at least 3 x 3 pixels is required")),
        (3, [], FILTER.format(5, 11, "3 x 3", "use w = 1, or a larger map")),
        (10, [], FILTER.format(5, 11, "10 x 10", "use w = 4 or less, or a larger map")),
        (10, ["--w", "5", "--downscale", "2"], "larger than the normal map of 5 x 5"),
    ],
)
def test_run_names_the_window_before_it_computes(make, sgp, size, words, complaint) -> None:
    make(size)
    answer = sgp("run", "images", "--lights", "lights.json", *words, "--out", "out")
    assert complaint in answer.error_line(4)
    assert not Path("out").exists()


@pytest.mark.parametrize("size", quick([1, 5, 10, 12], every=2))
@pytest.mark.parametrize(
    ("words", "least"),
    [
        (["normals", "images", "--lights", "lights.json", "--out", "out"], 1),
        (["inspect", "images", "--lights", "lights.json"], 1),
        (["surface", "map", "--out", "out", "--glb"], 2),
        (["curvature", "map", "--out", "out"], 2),
        (["detail", "separate", "map", "--out", "out"], 11),
        (["detail", "transfer", "map", "map", "--out", "out"], 11),
        (["compare", "map", "map"], 1),
    ],
    ids=lambda words: "-".join(words[:2]) if isinstance(words, list) else None,
)
def test_sizes(make, sgp, size, words, least) -> None:
    make(size)
    answer = sgp(*words)
    if size >= least:
        assert answer.code == 0, answer.err
    else:
        assert f"normal map of {size} x {size}" in answer.error_line(
            5 if size == 1 == least - 1 else 4
        )
