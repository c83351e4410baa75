"""The benchmark of layouts expects errors that follow from the geometry alone."""

from types import SimpleNamespace

import numpy as np
import pytest

from simulator import ChromeSphere, bench_camera

BENCHMARK = "sphere_layouts"
CORNERS = [(-90.0, -70.0), (90.0, 70.0), (-90.0, 70.0), (90.0, -70.0)]


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


def test_the_table_lists_the_seeds_that_fall_short(benchmark):
    good = {"wanted": 2, "found": 2, "expected_mm": 0.9, "positions_mm": 0.5}
    scores = [
        benchmark.Score(7, "plain", **good),
        benchmark.Score(8, "plain", **{**good, "positions_mm": 2.1}),
        benchmark.Score(9, "plain", **good, warnings=("lights-uncertain",)),
        benchmark.Score(7, "patterned", **{**good, "found": 1}, missed=["(1,2,r20)"]),
    ]
    rows = dict(line[2:-2].split(" | ", 1) for line in benchmark.table(scores).splitlines()[2:])
    assert rows["spheres found"] == "6 of 6 (100.0 %) | 1 of 2 (50.0 %)"
    assert rows["seeds with a missed sphere"] == "none | 7"
    assert rows["seeds beyond 2 mm without a warning"] == "8 | none"
    assert rows["solvable layouts without a warning"] == "2 of 3 (67 %) | 1 of 1 (100 %)"
    assert rows["solvable, but not without a warning"] == "9 0.50 mm lights-uncertain | none"


def test_scores_of_this_code_are_read_again(benchmark, tmp_path):
    path = tmp_path / "scores.jsonl"
    scores = [benchmark.Score(seed, "plain", warnings=("one-sphere",)) for seed in (1, 2)]
    benchmark.append_score(path, "new", scores[0])
    benchmark.append_score(path, "old", scores[1])
    with path.open("a") as file:
        file.write('{"code": "new", "se')
    assert list(map(str, benchmark.read_scores(path, "new"))) == [str(scores[0])]
    assert benchmark.read_scores(tmp_path / "none.jsonl", "new") == []
