"""Panels: what their pictures show, and that their texts cover nothing."""

import itertools
from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.patches import Ellipse

from acquisition import LightErrors, Lights
from processing import HeightProfile, NormalMap
from sgp.commands.compare import distinct_names
from sgp.pictures import (
    Crop,
    detail_panel,
    ellipsoids_panel,
    image_panel,
    lights_panel,
    map_panel,
    normals_panel,
    residuals_panel,
    shaded_panel,
    signed_panel,
)
from sgp.pictures.lights import short_names
from sgp.pictures.maps import bar_mm
from sgp.pictures.sheet import sheet
from sgp.stages.write_profile import profile_panels


def shown(panel):
    """Draw a panel; return its picture, if it has one, and its axes."""
    axes = sheet("", [panel], columns=1).axes[0]
    return next(iter(axes.images), None), axes


@pytest.mark.parametrize("offset", [0.0, 3.0, -3.0])
def test_a_signed_map_is_gray_at_zero(offset):
    values = np.linspace(-1, 1, 400, dtype=np.float32).reshape(20, 20) + np.float32(offset)
    image, _ = shown(signed_panel("error", values, "mm"))
    assert image.norm.vmin == -image.norm.vmax
    assert image.norm(0.0) == 0.5
    red, green, blue, _ = image.cmap(image.norm(np.array([0.0])))[0]
    assert max(red, green, blue) - min(red, green, blue) < 0.02
    assert red < 0.9, "white is outside of the object"
    colours = image.cmap(image.norm(np.array([-abs(image.norm.vmax), image.norm.vmax])))
    assert colours[0, 2] > colours[0, 0] + 0.2, "negative is blue"
    assert colours[1, 0] > colours[1, 2] + 0.2, "positive is red"


def test_a_constant_map_and_an_empty_map_can_be_drawn():
    for values in (np.zeros((5, 7)), np.full((5, 7), np.nan), np.ones((1, 1))):
        for panel in (
            map_panel("map", values, "mm"),
            map_panel("map", values, "deg", error=True),
            signed_panel("map", values, "mm"),
            shaded_panel("map", values),
        ):
            shown(panel)


def sphere(side=101):
    y, x = np.mgrid[:side, :side].astype(np.float32) * (2 / (side - 1)) - 1
    inside = x**2 + y**2 < 0.9
    z = np.sqrt(np.where(inside, 1 - x**2 - y**2, 1))
    normals = np.stack([x, -y, z], axis=-1) * inside[..., None]
    return NormalMap(normals.astype(np.float32), inside), np.where(inside, z * side / 2, np.nan)


def test_a_ball_is_raised_and_up_is_up():
    normal_map, height = sphere()
    image, _ = shown(shaded_panel("surface", height.astype(np.float32)))
    picture = image.get_array()
    middle = picture.shape[0] // 2
    quarter = middle // 2
    assert picture[quarter, quarter] > picture[-quarter, -quarter] + 0.3
    image, _ = shown(normals_panel("normals", normal_map))
    picture = image.get_array()
    assert picture[quarter, middle, 1] > 0.6 > 0.4 > picture[-quarter, middle, 1]
    assert picture[middle, -quarter, 0] > 0.6 > 0.4 > picture[middle, quarter, 0]


@pytest.mark.parametrize(("slope", "gain"), [(0.004, 100), (0.03, 20), (0.09, 10), (0.6, 1)])
def test_detail_states_the_gain_that_it_shows(slope, gain):
    normals = np.zeros((20, 30, 3), np.float32)
    normals[..., 0], normals[..., 2] = slope, 1
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    panel = detail_panel("detail", NormalMap(normals, np.ones((20, 30), bool)))
    assert panel.title == f"detail, slopes x {gain}"
    red, _, blue = 2 * shown(panel)[0].get_array()[10, 10] - 1
    assert red / blue == pytest.approx(gain * slope, rel=1e-4)


def test_a_saturated_pixel_is_white_and_gray_and_colour_images_are_drawn():
    image = np.full((10, 12), 0.2, np.float32)
    image[3, 4] = np.nan
    crop = Crop.around(np.ones(image.shape, bool))
    for one in (image, np.repeat(image[..., None], 3, axis=2)):
        assert np.all(shown(image_panel("light", one, crop))[0].get_array()[3, 4] == 1)


def test_a_large_map_is_averaged_over_its_valid_pixels():
    values = np.ones((1500, 3100), np.float32)
    values[::2] = 3
    values[:, :1000] = np.nan
    crop = Crop.around(np.ones(values.shape, bool))
    picture = crop.picture(values)
    assert picture.shape == (339, 700)
    # 1000 of 3100 columns are unknown.
    assert np.isnan(picture[:, :225]).all()
    assert picture[5:-5, 228:] == pytest.approx(2.0, abs=0.3)
    assert np.nanmean(picture) == pytest.approx(2.0, abs=0.01)


@pytest.mark.parametrize("channels", [(), (3,)])
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("size", [(1501, 903), (900, 1400), (650, 60)])
def test_bands_of_rows_give_the_picture_of_the_whole_map(size, masked, channels):
    rng = np.random.default_rng(3)
    values = rng.normal(size=(*size, *channels)).astype(np.float32)
    values[rng.random(size) < 0.4] = np.nan
    mask = rng.random(size) < 0.8
    # Frames on all sides, and a height that no band divides.
    crop = Crop(slice(7, size[0] - 3), slice(5, size[1] - 11))
    picture = crop.picture(values, mask if masked else None)
    if masked:
        values[~mask] = np.nan
    part = values[crop.rows, crop.columns]
    if crop.step > 1:
        rows, columns = (round(side / crop.step) for side in crop.size)
        share, total = (
            cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA)
            for image in (np.isfinite(part).astype(np.float32), np.nan_to_num(part))
        )
        part = np.where(share > 0.5, total / np.maximum(share, 1e-6), np.nan)
    np.testing.assert_allclose(picture, part, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(("width", "bar"), [(210.0, 50), (10.0, 2), (3.0, 1), (0.06, 0.02)])
def test_a_scale_bar_has_a_round_length(width, bar):
    assert bar_mm(width) == pytest.approx(bar)
    values = np.zeros((30, 300))
    crop = Crop.around(np.ones(values.shape, bool), width / 300)
    _, axes = shown(map_panel("height", values, "mm", crop))
    (line,) = axes.lines
    assert np.ptp(line.get_xdata()) * width / 300 == pytest.approx(bar)
    assert axes.texts[0].get_text() == f"{bar:g} mm"
    assert not shown(map_panel("height", values, "px"))[1].lines


def rings(count, *polar_deg):
    turn = np.arange(count) * 2 * np.pi * len(polar_deg) / count
    polar = np.radians(np.repeat(polar_deg, count // len(polar_deg)))
    return np.stack(
        [np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=1
    )


def grid(count):
    y, x = np.divmod(np.arange(count), 12)
    directions = np.stack([(x - 5.5) / 14, (y - 3.5) / 14, np.ones(count)], axis=1)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


@pytest.mark.parametrize(
    ("directions", "named"),
    [
        pytest.param(rings(36, 50, 56), 36, id="two close rings"),
        pytest.param(grid(96), 20, id="96 in a grid"),
        pytest.param(np.tile(rings(1, 30), (12, 1)), 1, id="one place"),
        pytest.param(rings(8, 89), 8, id="horizon"),
    ],
)
@pytest.mark.parametrize("truth", [False, True])
def test_names_of_lights_and_rings_cover_nothing(directions, named, truth):
    lights = Lights(ids=tuple(f"L{i:02}" for i in range(len(directions))), directions=directions)
    _, axes = shown(lights_panel("lights", lights, lights if truth else None))
    texts = [text for text in axes.texts if "named" not in text.get_text()]
    boxes = [text.get_window_extent() for text in texts]
    for a, b in itertools.combinations(boxes, 2):
        assert not a.overlaps(b)
    # Not even the middle of a mark is covered.
    marks = axes.transData.transform(lights.unit_directions[:, :2])
    frame = axes.get_window_extent()
    for text, box in zip(texts, boxes, strict=True):
        assert not any(box.contains(*mark) for mark in marks), text.get_text()
        assert frame.x0 <= box.x0 < box.x1 <= frame.x1
    names = [text.get_text() for text in texts]
    assert {"30°", "60°", "90°"} <= set(names)
    found = [name for name in names if "°" not in name]
    assert len(found) >= named
    note = [text.get_text() for text in axes.texts if "named" in text.get_text()]
    assert note == (
        [] if len(found) == len(lights) else [f"{len(found)} of {len(lights)} lights are named"]
    )
    # Each name is nearest to its own light.
    for text, box in zip(texts, boxes, strict=True):
        if "°" not in text.get_text():
            middle = (box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2
            away = np.hypot(*(marks - middle).T)
            assert away[int(text.get_text())] <= away.min() + 1


@pytest.mark.parametrize(
    ("ids", "short"),
    [
        (("L00", "L01", "L35"), ["00", "01", "35"]),
        (("buddha.0", "buddha.11"), ["0", "11"]),
        (("img_001.jpg", "img_102.jpg"), ["001", "102"]),
        (("top", "left"), ["top", "left"]),
        (("a", "ab"), ["a", "ab"]),
        (("L7",), ["7"]),
    ],
)
def test_short_names(ids, short):
    assert short_names(ids) == short


@pytest.mark.parametrize(
    ("a", "b", "names"),
    [
        ("x/normals", "y/truth.exr", ("normals", "truth.exr")),
        ("x/normals", "y/normals", ("x/normals", "y/normals")),
        ("x/a/normals", "y/a/normals", ("x/a/normals", "y/a/normals")),
        ("a.png", "/tmp/b/a.png", None),
        ("same", "same", ("same", "same")),
    ],
)
def test_error_maps_name_the_files_compared(a, b, names):
    found = distinct_names(Path(a), Path(b))
    assert found == names if names else found[0] != found[1]


def test_a_profile_counts_every_pixel_and_shows_where_its_branches_are():
    target = np.linspace(0, 10, 5000, dtype=np.float32)
    lower = np.arange(5000) % 5 == 0  # a fifth of the object is 3 too low
    result = np.where(lower, target - 3, target).astype(np.float32)
    difference = (result - target).reshape(50, 100)
    profile = HeightProfile(target, result, result, "px", difference)
    plot, means, where = profile_panels("a on b", profile)
    image, axes = shown(plot)
    assert image.get_array().sum() == pytest.approx(5000, rel=0.01)
    # Both branches are visible in each column of the plot.
    branches = (image.get_array().filled(0) > 0).sum(axis=0)
    assert np.median(branches) >= 2
    assert axes.get_legend().get_texts()[0].get_text() == "target, sorted"
    assert shown(means)[0] is not None
    picture = shown(where)[0].get_array()
    assert sorted(np.unique(picture.round(3))) == [-3, 0]
    assert (picture < -1).mean() == pytest.approx(0.2)


def test_ellipsoids_are_enlarged_by_the_factor_in_the_title():
    """With 2 mm at 400 mm, a semi-axis of 6 % of the distance is 12 times as long: 10 times."""
    covariances = np.repeat(np.diag([4.0, 1.0, 1.0])[None], 3, axis=0)
    covariances[2] = np.nan
    lights = Lights(
        positions_mm=400 * rings(3, 40),
        errors=LightErrors(covariances, residual_px=np.full(3, 0.1)),
    )
    panel = ellipsoids_panel(lights)
    assert panel.title == "error ellipsoids (1 sigma), enlarged 10 times; median 2 mm, largest 2 mm"
    _, axes = shown(panel)
    shapes = [patch for patch in axes.patches if isinstance(patch, Ellipse)]
    assert len(shapes) == 2
    # Seen from an azimuth of -60 degrees, the X axis is at 60 degrees to the line of sight.
    assert all(20 < shape.width <= 40 for shape in shapes)
    assert len(shown(residuals_panel(lights))[1].patches) == 3


def test_the_residuals_are_inside_the_picture_in_its_first_column():
    errors = LightErrors(residual_px=np.array([0.0041, 0.002, 0.0013]))
    figure = sheet("title", [residuals_panel(Lights(directions=rings(3, 40), errors=errors))], 2)
    figure.canvas.draw()
    (axes,) = figure.axes
    assert any(text.get_text().endswith("those predicted, px") for text in figure.texts)
    assert axes.get_tightbbox().x0 >= 0


def test_directions_have_ellipsoids_in_degrees_and_lights_without_errors_have_none():
    variance = np.radians(0.5) ** 2
    lights = Lights(
        directions=rings(4, 30), errors=LightErrors(np.tile(variance * np.eye(2), (4, 1, 1)))
    )
    assert "median 0.5°, largest 0.5°" in ellipsoids_panel(lights).title
    assert residuals_panel(lights) is None
    plain = Lights(directions=rings(4, 30))
    assert ellipsoids_panel(plain) is None
    assert residuals_panel(plain) is None
