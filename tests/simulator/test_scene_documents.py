"""docs/scenes.md has all kinds with their keys and defaults; its examples are scenes."""

import inspect
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
import trimesh

from simulator import SCENES, read_scene, render, write_scene
from simulator.scene import Ball, Box
from simulator.scene.scene_parts import BODIES, CLUTTER, LENSES, LIGHTS, MATERIALS, PATTERNS
from simulator.shapes import BandNoise, Checker
from tests.simulator.conftest import SMALL


def test_clutter_and_relief_are_written_and_read(write, tmp_path):
    example = (
        documented().partition("`[[clutter]]`")[2].partition("```toml\n")[2].partition("```")[0]
    )
    scene = read_scene(write(f"seed = 3\n{example}\n{SMALL}"))
    assert scene.clutter == (
        Ball((-60.0, 40.0, 15.0), 15.0, roughness=0.1),
        Box((0.0, -50.0), (40.0, 25.0, 18.0), turn_deg=25.0),
    )
    assert scene.relief == BandNoise(260.0, 0.1, 8.0, seed=3)
    assert scene.board == Checker(0.1, 0.7, 15.0)
    again = read_scene(write_scene(tmp_path / "again.toml", scene)[0])
    assert (again.clutter, again.relief, again.board) == (scene.clutter, scene.relief, scene.board)
    np.testing.assert_array_equal(render(again).planes, render(scene).planes)


def documented() -> str:
    return (Path(__file__).parents[2] / "docs" / "scenes.md").read_text(encoding="utf-8")


def value_of(text: str) -> object:
    """Read a default from the documentation: TOML, except for bare words and ``none``."""
    if text == "none":
        return None
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
    return tuple(value) if isinstance(value, list) else value


@pytest.mark.parametrize(
    ("kinds", "heading"),
    [
        pytest.param(BODIES, "`[object]`", id="objects"),
        pytest.param(PATTERNS, "`[pattern]`", id="patterns"),
        pytest.param(MATERIALS, "`[material]`", id="materials"),
        pytest.param(CLUTTER, "`[[clutter]]`", id="clutter"),
        pytest.param(LIGHTS, "`[lights]`", id="lights"),
        pytest.param(LENSES, "`[lens]`", id="lenses"),
    ],
)
def test_the_documentation_has_all_kinds_with_keys_and_defaults(kinds, heading):
    section = documented().partition(f"### {heading}")[2].partition("\n### ")[0]
    rows = dict(re.findall(r"^\| `([a-z-]+)` \|.*\| (.*?) ?\|$", section, re.MULTILINE))
    assert rows.keys() == kinds.keys()
    for kind, maker in kinds.items():
        documented_keys = dict(re.findall(r"`(\w+)`(?: (\[.*?\]|[^,\s]+))?", rows[kind]))
        keys = inspect.signature(maker).parameters
        assert list(documented_keys) == list(keys), kind
        for name, text in documented_keys.items():
            default = keys[name].default
            if default is inspect.Parameter.empty:
                assert text == "", (kind, name)
            else:
                expected = pytest.approx(default) if isinstance(default, float) else default
                assert value_of(text) == expected, (kind, name)


def test_the_documented_example_is_a_scene(write, tmp_path):
    trimesh.creation.icosphere(subdivisions=1).export(tmp_path / "owl.obj")
    example = documented().partition("```toml\n")[2].partition("```")[0]
    scene = read_scene(write(example))
    assert scene.lens.cfa == "RGGB"
    assert len(scene.lights) == 24
    assert scene.body.radius_mm == pytest.approx(70.0)


def test_the_documentation_lists_the_scenes():
    rows = re.findall(r"^\| `([a-z-]+)` \| (.*) \|$", documented().partition("\n## ")[0], re.M)
    assert dict(rows) == SCENES
