"""The sheet with the overview pictures: equal slots, aligned columns, titles that fit."""

import itertools

import numpy as np
import pytest

from acquisition import read_image
from sgp.pictures import Crop, Panel, map_panel, signed_panel, write_overview
from sgp.pictures.sheet import sheet, text_size
from tests.quick_sample import quick


def plain(aspect=None, title="title"):
    return Panel(title, lambda axes: axes.axis("off"), aspect)


def in_inches(figure, axes):
    width, height = figure.get_size_inches()
    box = axes.get_position(original=True)
    return np.array([box.x0 * width, box.y0 * height, box.width * width, box.height * height])


@pytest.mark.parametrize(
    ("count", "columns", "rows"), [(1, 1, 1), (8, 4, 2), (9, 3, 3), (12, 4, 3), (14, 5, 3)]
)
def test_few_places_stay_empty(count, columns, rows):
    figure = sheet("", [plain(1.0) for _ in range(count)])
    assert figure.get_size_inches() == pytest.approx((4.5 * columns, 4.16 * rows))


def test_the_same_panels_give_the_same_file(tmp_path):
    files = [tmp_path / "a.png", tmp_path / "b.png"]
    for file in files:
        write_overview(file, "title", [plain(1.0), plain()])
    assert read_image(files[0]).shape[:2] == (461, 900)
    assert files[0].read_bytes() == files[1].read_bytes()


@pytest.mark.parametrize(
    ("height", "width"),
    quick([(30, 40), (40, 30), (200, 20), (20, 200), (30, 30), (2, 300)], every=3),
)
def test_panels_of_one_object_are_equal_and_aligned(height, width):
    values = np.random.default_rng(0).normal(size=(height, width)).astype(np.float32)
    crop = Crop.around(np.ones(values.shape, bool), 0.1)
    partly = np.where(np.arange(width) < width / 2, values, np.nan)
    panels = [
        map_panel("with a scale", values, "mm", crop),
        signed_panel("partly unknown", partly, "mm", crop),
        plain(1.0, "lights"),
        *[map_panel("error", values, "deg", crop, error=True) for _ in range(8)],
    ]
    figure = sheet("of a shape", panels)
    slots = np.array([in_inches(figure, axes) for axes in figure.axes[: len(panels)]])
    assert np.allclose(slots[:, 2:], slots[0, 2:])
    lefts, bottoms = (np.unique(slots[:, i].round(6)) for i in (0, 1))
    assert len(lefts) * len(bottoms) >= len(panels) > len(lefts) * (len(bottoms) - 1)
    # The pictures too, after matplotlib has fitted them into the slots.
    for axes in figure.axes[: len(panels)]:
        axes.apply_aspect()
    drawn = [axes.get_window_extent() for axes in figure.axes[: len(panels)]]
    maps = [box for box, panel in zip(drawn, panels, strict=True) if panel.title != "lights"]
    for box in maps:
        assert (box.width, box.height) == pytest.approx((maps[0].width, maps[0].height))
        assert box.width / box.height == pytest.approx(crop.aspect)


@pytest.mark.parametrize("aspect", [0.1, 1.0, 10.0])
@pytest.mark.parametrize(
    "title",
    [
        "normals (right red, up green)",
        "detail component of a thing with a long description, slopes x 50, and more words",
        "recordings/" + "a" * 150 + ".png",
        "\udcff and $x_1$",
    ],
)
def test_titles_stay_in_their_column(aspect, title):
    figure = sheet(title, [plain(aspect, title) for _ in range(3)], columns=3)
    width, height = figure.get_size_inches()
    boxes = []
    for text in figure.texts:
        across, _up = text_size(text)
        left = text.get_position()[0] * width - across / 2
        assert left >= 0
        assert left + across <= width
        boxes.append((left, left + across))
    titles = sorted(boxes[1:])
    assert all(a[1] < b[0] for a, b in itertools.pairwise(titles))
    top = max(text.get_position()[1] * height + text_size(text)[1] for text in figure.texts[1:])
    assert top <= figure.texts[0].get_position()[1] * height - text_size(figure.texts[0])[1] / 2
