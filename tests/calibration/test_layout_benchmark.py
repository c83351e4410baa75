"""The benchmark of layouts expects errors that follow from the geometry alone."""

import importlib.util
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from simulator import ChromeSphere, bench_camera

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
CORNERS = [(-90.0, -70.0), (90.0, 70.0), (-90.0, 70.0), (90.0, -70.0)]


@pytest.fixture(scope="module")
def benchmark():
    sys.path.insert(0, str(BENCHMARKS))
    try:
        spec = importlib.util.spec_from_file_location(
            "sphere_layouts", BENCHMARKS / "sphere_layouts.py"
        )
        module = importlib.util.module_from_spec(spec)
        sys.modules["sphere_layouts"] = module
        spec.loader.exec_module(module)
        yield module
    finally:
        sys.path.remove(str(BENCHMARKS))
        sys.modules.pop("sphere_layouts", None)


def expected(benchmark, count=4, radius=15.0, spread=1.0, width=960, height=804):
    turn = np.arange(6) * (np.pi / 3)
    lights = np.column_stack([200 * np.cos(turn), 200 * np.sin(turn), np.full(6, 400.0)])
    layout = SimpleNamespace(camera=bench_camera(height, width), lights_mm=lights)
    spheres = [ChromeSphere((spread * x, spread * y, radius), radius) for x, y in CORNERS[:count]]
    return benchmark.expected_mm(layout, spheres)


def test_fewer_than_two_spheres_give_no_positions(benchmark):
    assert expected(benchmark, 0) == expected(benchmark, 1) == np.inf


def test_more_larger_and_farther_spheres_and_more_pixels_are_better(benchmark):
    usual = expected(benchmark)
    assert 0.5 < usual < 3.0
    assert expected(benchmark, count=2) > usual
    assert expected(benchmark, radius=8.0) > usual
    assert expected(benchmark, spread=0.5) > usual
    assert expected(benchmark, width=640, height=536) > 1.3 * usual


def test_the_expected_error_is_proportional_to_the_errors_in_the_images(benchmark, monkeypatch):
    usual = expected(benchmark)
    for name in ("OUTLINE_PX", "HIGHLIGHT_PX"):
        monkeypatch.setattr(benchmark, name, 2 * getattr(benchmark, name))
    assert expected(benchmark) == pytest.approx(2 * usual, rel=0.02)


def test_a_layout_is_solvable_up_to_one_millimetre(benchmark):
    score = benchmark.Score(1, "plain", expected_mm=1.0)
    assert score.solvable
    score.expected_mm = 1.01
    assert not score.solvable
