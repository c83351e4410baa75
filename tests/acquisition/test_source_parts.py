"""Parts of a recording: without images, a region, a lower resolution, and masks from alpha."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition import (
    CameraModel,
    DataError,
    Lights,
    Source,
    crop,
    downscale,
    exclude,
    read_source,
    write_png,
)
from tests.cases import cases

HEIGHT, WIDTH = 22, 31
K = np.array([[50.0, 0.4, 14.2], [0, 52.0, 11.1], [0, 0, 1]])
CAMERA = CameraModel(K, WIDTH, HEIGHT, 300.0, np.array([0.02, 0.01, 1e-3, -1e-3, 0]))


def lights(count: int) -> Lights:
    around = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return Lights(np.stack([np.cos(around), np.sin(around), np.full(count, 1.5)], 1))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    place = tmp_path / "views"
    place.mkdir()
    for i in range(6):
        write_png(place / f"shot2_{i + 7}_v1.png", np.full((HEIGHT, WIDTH), 1000 * i, np.uint16))
    return place


@pytest.fixture
def source(folder: Path) -> Source:
    read = read_source(folder, lights=lights(6))
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[5:19, 8:26] = True
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, WIDTH), np.linspace(-0.5, 0.5, HEIGHT))
    truth = np.stack([x, y, np.sqrt(1 - x * x - y * y)], axis=2).astype(np.float32)
    truth[~mask] = 0
    return replace(read, mask=mask, camera=CAMERA, normals_truth=truth)


@pytest.mark.parametrize(
    ("images", "left"),
    [
        pytest.param(["shot2_8_v1"], [0, 2, 3, 4, 5], id="name"),
        pytest.param(["SHOT2_8_V1.png"], [0, 2, 3, 4, 5], id="file"),
        pytest.param(["8", "12"], [0, 2, 3, 4], id="numbers"),
        pytest.param(["7-9", " 11 "], [3, 5], id="range"),
        pytest.param(["9-7"], [3, 4, 5], id="backward"),
        pytest.param(["0-7"], [1, 2, 3, 4, 5], id="range with absent numbers"),
    ],
)
def test_images_are_left_out_with_their_lights(source, images, left) -> None:
    part = exclude(source, images)
    assert [frame.path for frame in part.frames] == [source.frames[i].path for i in left]
    np.testing.assert_array_equal(part.lights.directions, source.lights.directions[left])
    assert part.lights.ids == part.light_ids == tuple(source.light_ids[i] for i in left)


@pytest.mark.parametrize(
    ("images", "text"),
    [
        pytest.param(["2"], "no image is named '2': there are shot2_7_v1, .*_12_v1", id="common"),
        pytest.param(["99"], "no image is named '99'", id="absent"),
        pytest.param(["13-20"], "no image is named '13-20'", id="range"),
        pytest.param(["L07"], "no image is named 'L07'", id="name"),
        pytest.param([""], "no image is named ''", id="empty"),
        pytest.param(["0-99"], "no image is left: all 6 images are excluded", id="all"),
    ],
)
def test_wrong_images_are_refused(source, images, text) -> None:
    with pytest.raises(DataError, match=text):
        exclude(source, images)


def test_names_come_before_numbers(tmp_path) -> None:
    for name in ("1-2.png", "1-3.png", "1-4.png"):
        write_png(tmp_path / name, np.full((4, 5), 9, np.uint16))
    source = read_source(tmp_path)
    part = exclude(source, ["1-3"])
    assert part.light_ids == ("1-2", "1-4")
    assert part.warnings == source.warnings
    assert exclude(source, ["2"]).light_ids == ("1-3", "1-4")


@pytest.mark.parametrize(
    ("images", "texts"),
    [
        (["0-8", "11-12"], ["0-8 leaves out 2 images: the images have the numbers 7 to 12"]),
        (["14-12"], ["12-14 leaves out 1 image: the images have the numbers 7 to 12"]),
        (["7-8", "9", "shot2_12_v1"], []),
    ],
)
def test_a_range_that_the_numbers_do_not_cover_is_noted(source, images, texts) -> None:
    notices = exclude(source, images).warnings[len(source.warnings) :]
    assert [(notice.code, notice.text) for notice in notices] == [
        ("range-beyond-images", text) for text in texts
    ]


def test_a_crop_has_mask_camera_and_truth_of_the_region(source) -> None:
    part = crop(source, 6, 3, 17, 12)
    window = np.s_[3:15, 6:23]
    assert part.size == part.camera.size == (12, 17)
    np.testing.assert_array_equal(part.mask, source.mask[window])
    np.testing.assert_array_equal(part.normals_truth, source.normals_truth[window])
    points = CAMERA.points_on_plane()
    np.testing.assert_allclose(part.camera.points_on_plane(), points[window], atol=1e-9)
    # The frames stay as they are, and a region of a region is one of the first image.
    assert part.frames == source.frames
    again = crop(part, 2, 1, 5, 4)
    once = crop(source, 8, 4, 5, 4)
    assert again.reduction == once.reduction
    np.testing.assert_array_equal(again.camera.K, once.camera.K)


def test_a_lower_resolution_averages_mask_camera_and_truth(source) -> None:
    part = downscale(source, 3)
    assert part.size == part.camera.size == (7, 10)
    blocks = source.mask[:21, :30].reshape(7, 3, 10, 3)
    np.testing.assert_array_equal(part.mask, blocks.all(axis=(1, 3)))
    straight = replace(CAMERA, distortion=np.zeros(5))
    reduced = replace(part.camera, distortion=np.zeros(5))
    means = straight.points_on_plane()[:21, :30].reshape(7, 3, 10, 3, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(reduced.points_on_plane(), means, atol=1e-9)
    length = np.linalg.norm(part.normals_truth, axis=2)
    np.testing.assert_allclose(length, part.mask, atol=1e-6)
    middle = source.normals_truth[1:21:3, 1:30:3]
    np.testing.assert_allclose(part.normals_truth[part.mask], middle[part.mask], atol=2e-3)


def test_reductions_can_be_chained(source) -> None:
    part = downscale(crop(downscale(source, 2), 1, 2, 13, 9), 2)
    once = downscale(crop(source, 2, 4, 24, 16), 4)
    assert part.size == once.size == (4, 6)
    assert (part.reduction.x, part.reduction.y, part.reduction.factor) == (2, 4, 4)
    np.testing.assert_allclose(part.camera.K, once.camera.K)
    np.testing.assert_array_equal(part.mask, once.mask)


@cases(
    ("change", "text"),
    {
        "x": (lambda s: crop(s, 20, 0, 12, 5), "is not inside the images of 31 x 22"),
        "negative": (lambda s: crop(s, 0, -1, 9, 5), "is not inside"),
        "empty": (lambda s: crop(s, 9, 9, 0, 5), "is not inside"),
        "outside": (lambda s: crop(s, 0, 0, 8, 5), "contains no pixel of the mask"),
        "zero": (lambda s: downscale(s, 0), "give 1 to 22"),
        "larger than the image": (lambda s: downscale(s, 23), "give 1 to 22"),
        "no block": (lambda s: downscale(s, 11), "completely within the mask"),
        "twice": (lambda s: crop(crop(s, 5, 5, 9, 9), 0, 0, 10, 2), "9 x 9 pixels"),
    },
)
def test_wrong_parts_are_refused(source, change, text) -> None:
    with pytest.raises(DataError, match=text):
        change(source)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda s: exclude(s, "7"), id="text"),
        pytest.param(lambda s: crop(s, 0.5, 0, 3, 3), id="fraction"),
        pytest.param(lambda s: downscale(s, 2.0), id="factor"),
        pytest.param(lambda s: exclude(s.frames, ["7"]), id="frames"),
    ],
)
def test_wrong_types_are_named(source, change) -> None:
    with pytest.raises(TypeError):
        change(source)


def rgba(folder: Path, alphas: list[np.ndarray | None]) -> None:
    folder.mkdir()
    for i, alpha in enumerate(alphas):
        pixels = np.full((6, 8, 3), 100 + i, np.uint8)
        write_png(folder / f"a.{i}.png", pixels, alpha=alpha)


def test_the_alpha_of_photographs_is_their_mask(tmp_path) -> None:
    first, second = np.ones((2, 6, 8), bool)
    first[0], second[:, 0] = False, False
    rgba(tmp_path / "cut", [first, second, None])
    source = read_source(tmp_path / "cut")
    np.testing.assert_array_equal(source.mask, first & second)
    assert (source.mask_origin, source.mask_path) == ("alpha", None)
    notices = [notice for notice in source.warnings if notice.code == "alpha-is-mask"]
    assert [notice.severity for notice in notices] == ["info"]
    assert "35 of 48 pixels" in notices[0].text
    assert source.frames[0].read().shape == (6, 8, 3)


def test_opaque_or_empty_alpha_and_a_mask_file(tmp_path) -> None:
    whole = np.ones((6, 8), bool)
    rgba(tmp_path / "opaque", [whole, whole])
    assert read_source(tmp_path / "opaque").mask is None
    rgba(tmp_path / "empty", [whole, ~whole])
    with pytest.raises(DataError, match="leaves no pixel: save them without alpha, or give a mask"):
        read_source(tmp_path / "empty")
    mask = whole.copy()
    mask[2] = False
    write_png(tmp_path / "m.png", mask.astype(np.uint8) * np.uint8(255))
    given = read_source(tmp_path / "empty", mask_path=tmp_path / "m.png")
    np.testing.assert_array_equal(given.mask, mask)
    assert given.mask_origin == "given"
