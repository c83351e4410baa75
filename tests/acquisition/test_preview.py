"""Live frames and their pictures, against raw values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.preview import Composite, LiveFrame, Marks, Region, picture_of
from acquisition.preview.live_picture import CLIPPED, PEAKING
from rig import RigConfig
from rig.arrays import UInt16
from rig.config import Mounting
from simulator import open_rig_seeing, render, scene_named

WHITE = 4095
PLAIN = Marks(clipped=False)


def live(pixels: UInt16, cfa: str | None = None, number: int = 1, led: int = 3) -> LiveFrame:
    return LiveFrame(number, (led,), pixels, pixels >= WHITE, 64.0, WHITE, cfa, 10_000.0, 0.0)


def noise(height: int, width: int, seed: int = 1) -> UInt16:
    return np.random.default_rng(seed).integers(64, WHITE + 1, (height, width)).astype(np.uint16)


def shade(dn: float) -> int:
    return round(255 * ((dn - 64) / (WHITE - 64)) ** (1 / 2.2))


def test_a_picture_shows_raw_values_with_gamma() -> None:
    pixels = np.array([[64, 1000], [4000, 4094]], np.uint16)
    picture = picture_of(live(pixels), Region(0, 0, 2, 2), (10, 10), PLAIN)
    assert np.array_equal(picture[..., 0], picture[..., 2])
    for dn, seen in zip(pixels.ravel(), picture[..., 1].ravel(), strict=True):
        assert abs(int(seen) - shade(dn)) <= 1


def test_the_clipped_marks_of_a_full_size_picture_are_the_raw_mask() -> None:
    pixels = noise(60, 80)
    pixels[pixels > 4000] = WHITE
    region = Region(13, 7, 40, 30)
    picture = picture_of(live(pixels), region, (30, 40))
    marked = (picture == CLIPPED).all(axis=2)
    assert np.array_equal(marked, pixels[7:37, 13:53] == WHITE)
    assert marked.any()


@given(
    st.integers(1, 40), st.integers(1, 40), st.integers(1, 40), st.integers(1, 40),
    st.data(),
)  # fmt: skip
def test_a_reduced_picture_marks_every_block_with_a_clipped_sample(
    height: int, width: int, rows: int, columns: int, data: st.DataObject
) -> None:
    pixels = np.full((height, width), 500, np.uint16)
    y, x = data.draw(st.integers(0, height - 1)), data.draw(st.integers(0, width - 1))
    pixels[y, x] = WHITE
    picture = picture_of(live(pixels), Region(0, 0, width, height), (rows, columns))
    assert picture.shape[0] <= rows
    assert picture.shape[1] <= columns
    block = max(-(-height // rows), -(-width // columns))
    marked = np.argwhere((picture == CLIPPED).all(axis=2))
    assert marked.tolist() == [[y // block, x // block]]


def test_a_reduced_picture_shows_means() -> None:
    pixels = noise(90, 120)
    picture = picture_of(live(pixels), Region(0, 0, 120, 90), (30, 40), PLAIN)
    means = pixels.reshape(30, 3, 40, 3).mean(axis=(1, 3))
    assert max(
        abs(int(seen) - shade(dn))
        for seen, dn in zip(picture[..., 0].ravel(), means.ravel(), strict=True)
    ) <= 1  # fmt: skip


@pytest.mark.parametrize("cfa", ["RGGB", "BGGR", "GRBG", "GBRG"])
@pytest.mark.parametrize("corner", [(0, 0), (1, 0), (0, 1), (1, 1)])
def test_colours_are_those_of_the_filter(cfa: str, corner: tuple[int, int]) -> None:
    levels = {"R": 3000, "G": 1500, "B": 400}
    block = np.array([levels[colour] for colour in cfa], np.uint16).reshape(2, 2)
    frame = live(np.tile(block, (20, 20)), cfa)
    picture = picture_of(frame, Region(*corner, 30, 30), (30, 30), PLAIN)
    middle = picture[5:-5, 5:-5].reshape(-1, 3)
    assert np.abs(middle.astype(int) - [shade(levels[one]) for one in "RGB"]).max() <= 1


def test_peaking_marks_a_sharp_edge_and_not_a_blurred_one() -> None:
    rng = np.random.default_rng(5)
    across = np.arange(200.0)
    sharp, soft = 1 / (1 + np.exp(-(across - 100))), 1 / (1 + np.exp(-(across - 100) / 12))
    for edge, marked in ((sharp, True), (soft, False)):
        light = 500 + 2000 * np.tile(edge, (80, 1))
        pixels = (light + rng.normal(0, 4, light.shape)).astype(np.uint16)
        picture = picture_of(live(pixels), Region(0, 0, 200, 80), (80, 200), Marks(False, True))
        columns = (picture == PEAKING).all(axis=2).mean(axis=0)
        assert bool(columns[95:105].max() > 0.9) is marked
        assert columns[:80].max() < 0.1


def test_a_histogram_counts_every_sample_and_its_last_bar_the_clipped_ones() -> None:
    pixels = noise(50, 70)
    pixels[:3] = WHITE
    frame = live(pixels)
    assert frame.histogram.sum() == pixels.size
    assert frame.histogram[-1] >= (pixels == WHITE).sum() == round(frame.clipped_fraction * 3500)
    assert frame.histogram[0] == (pixels < 64).sum()


@pytest.mark.parametrize("region", [Region(-5, -5, 3, 3), Region(500, 2, 9, 9), Region(0, 0, 1, 1)])
def test_a_region_outside_the_frame_is_moved_into_it(region: Region) -> None:
    within = region.within((40, 60))
    assert 0 <= within.left < within.left + within.width <= 60
    assert 0 <= within.top < within.top + within.height <= 40
    assert live(noise(40, 60)).quality(region).mean_dn is not None


def test_the_focus_measure_falls_with_blur() -> None:
    import cv2

    frame = live(noise(80, 80))
    blurred = replace(frame, pixels=cv2.GaussianBlur(frame.pixels, (0, 0), 1.5))
    assert blurred.quality().sharpness < 0.5 * frame.quality().sharpness


def test_a_composite_is_the_mean_and_is_clipped_where_any_frame_is() -> None:
    composite = Composite()
    first, second = (live(noise(9, 12, seed), number=seed, led=seed) for seed in (1, 2))
    composite.add(first)
    composite.add(second)
    frame = composite.frame(second)
    assert frame.leds == (1, 2)
    mean = (first.pixels.astype(float) + second.pixels) / 2
    assert np.abs(frame.pixels - mean).max() <= 0.5
    assert np.array_equal(frame.clipped, first.clipped | second.clipped)


@pytest.mark.usefixtures("simulated_world")
def test_a_live_frame_of_a_turned_camera_is_upright() -> None:
    view = render(scene_named("coin", width=64, height=48, leds=4))
    config = RigConfig(name="desk", driver="simulated", leds=4, mounting=Mounting(rotation_deg=90))
    with open_rig_seeing(view, config=config, realtime=False, camera="inside", noisy=False) as rig:
        turned = LiveFrame.of(1, rig.shoot(2, 20_000.0), rig)
    with open_rig_seeing(view, realtime=False, camera="inside", noisy=False) as rig:
        straight = LiveFrame.of(1, rig.shoot(2, 20_000.0), rig)
    assert turned.leds == (2,)
    assert turned.size == straight.size == (48, 64)
    assert np.array_equal(turned.pixels, straight.pixels)
