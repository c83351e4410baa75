"""Distinguish frames with and without light, on frames with realistic noise."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from acquisition import DataError
from acquisition.engine.rejection import SeenLight, is_lit, rejection
from acquisition.pixels import FrameQuality, measure_quality
from acquisition.plan import PlannedShot
from rig import RigError
from rig.arrays import Float64

SIZE = (480, 640)
BLACK, WHITE = 64.0, 4095.0


def frame(seed: int, light_dn: Float64 | float = 0.0, offset_dn: float = 0.0) -> FrameQuality:
    """Return a frame with shot noise, 2 DN of read noise and a fixed set of hot pixels."""
    rng = np.random.default_rng(seed)
    image = (
        BLACK + offset_dn + rng.poisson(np.broadcast_to(light_dn, SIZE)) + rng.normal(0, 2, SIZE)
    )
    hot = np.random.default_rng(99).integers(0, SIZE[0] * SIZE[1], 40)
    image.ravel()[hot] += 300
    raw = np.clip(np.round(image), 0, WHITE).astype(np.uint16)
    return measure_quality(raw, white_level_dn=WHITE, black_level_dn=BLACK)


def spot(pixels: int, bright_dn: float) -> Float64:
    light = np.zeros(SIZE)
    light.ravel()[100_000 : 100_000 + pixels] = bright_dn
    return light


@functools.cache
def unlit() -> dict[str, int]:
    """Return the percentiles of a frame without light."""
    return frame(0).percentiles_dn


@pytest.mark.parametrize("seed", range(1, 21))
def test_a_frame_without_light_is_not_lit(seed: int) -> None:
    assert not is_lit(frame(seed).percentiles_dn, unlit(), WHITE - BLACK)


@pytest.mark.parametrize("offset_dn", [-2.0, 1.0, 2.0])
def test_a_drifting_black_level_is_not_light(offset_dn: float) -> None:
    drifted = frame(1, offset_dn=offset_dn).percentiles_dn
    assert not is_lit(drifted, unlit(), WHITE - BLACK)


@pytest.mark.parametrize(
    "light_dn",
    [
        pytest.param(6.0, id="dim everywhere"),
        pytest.param(1500.0, id="bright everywhere"),
        pytest.param(spot(SIZE[0] * SIZE[1] // 50, 30.0), id="a dim object in a black field"),
        pytest.param(spot(12, 2500.0), id="only a highlight on a ball"),
    ],
)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_light_is_seen(light_dn: Float64 | float, seed: int) -> None:
    assert is_lit(frame(seed, light_dn).percentiles_dn, unlit(), WHITE - BLACK)


LIGHT = PlannedShot("light", 7, 0, 0, 500.0)


def judged(
    shot: PlannedShot,
    quality: FrameQuality,
    *,
    dark: bool = True,
    seen: SeenLight | None = None,
    limit: float = 1.0,
) -> RigError | DataError | None:
    return rejection(
        shot,
        quality,
        dark=frame(0) if dark else None,
        seen=seen,
        range_dn=WHITE - BLACK,
        max_clipped_fraction=limit,
    )


def test_the_led_and_what_to_do_are_named() -> None:
    error = judged(LIGHT, frame(1))
    assert isinstance(error, RigError)
    assert str(error).startswith("L07_E0.tif: LED 7 gave no light at 500 us")
    assert "dead_leds" in str(error)
    assert "\n" not in str(error)


def test_a_dark_frame_with_light_is_reported_as_the_cause() -> None:
    """An operator who opened the door during it must not be sent to look for a broken LED."""
    error = rejection(
        LIGHT, frame(1), dark=frame(0, 200.0), range_dn=WHITE - BLACK, max_clipped_fraction=1.0
    )
    assert isinstance(error, RigError)
    assert "is darker at 500 us than the frame with all LEDs off" in str(error)
    assert "new folder" in str(error)


def test_clipping_is_reported_with_its_limit() -> None:
    error = judged(LIGHT, frame(1, spot(3072 * 4, 9000.0)), limit=0.02)
    assert isinstance(error, DataError)
    assert "4.000% of the samples are clipped at 500 us, the plan allows 2.000%" in str(error)
    assert judged(LIGHT, frame(1, spot(3072 * 4, 9000.0)), limit=0.05) is None


@pytest.mark.parametrize(
    ("shot", "dark"),
    [
        pytest.param(PlannedShot("dark", None, 0, 0, 500.0), True, id="a dark frame"),
        pytest.param(PlannedShot("ambient", None, 0, 0, 500.0), True, id="an ambient frame"),
        pytest.param(LIGHT, False, id="no dark frame to compare with"),
    ],
)
def test_frames_that_are_not_judged_by_their_light(shot: PlannedShot, dark: bool) -> None:
    assert judged(shot, frame(1), dark=dark) is None


def test_a_flat_is_judged_by_the_led_that_lights_it() -> None:
    error = judged(PlannedShot("flat", 3, 0, 0, 500.0), frame(1))
    assert "LED 3 gave no light" in str(error)


def gave(light_dn: Float64 | float, exposure_us: float) -> SeenLight | None:
    return SeenLight.of(exposure_us, frame(2, light_dn).percentiles_dn, unlit(), WHITE - BLACK)


@pytest.mark.parametrize(
    ("light_dn", "exposure_us"),
    [
        pytest.param(100.0, 20_000.0, id="2.5 DN are lost in the noise"),
        pytest.param(spot(SIZE[0] * SIZE[1] // 50, 300.0), 20_000.0, id="a dim object"),
        pytest.param(spot(12, 2500.0), 5_000.0, id="a highlight"),
    ],
)
def test_an_exposure_too_short_for_its_light_counts(
    light_dn: Float64 | float, exposure_us: float
) -> None:
    light = gave(light_dn, exposure_us)
    assert light is not None
    assert judged(LIGHT, frame(1), seen=light) is None


@pytest.mark.parametrize(
    ("light_dn", "exposure_us"),
    [
        pytest.param(1500.0, 20_000.0, id="37 DN would be seen"),
        pytest.param(spot(SIZE[0] * SIZE[1] // 50, 2500.0), 20_000.0, id="62 DN of an object"),
        pytest.param(spot(12, 2500.0), 1_000.0, id="a highlight"),
    ],
)
def test_light_that_must_be_visible_is_missing(
    light_dn: Float64 | float, exposure_us: float
) -> None:
    error = judged(LIGHT, frame(1), seen=gave(light_dn, exposure_us))
    assert isinstance(error, RigError)


def test_a_frame_without_light_is_not_a_reference() -> None:
    assert gave(0.0, 20_000.0) is None


def levels(low: int, high: int, brightest: int | None = None) -> dict[str, int]:
    """Return the percentiles of a frame between two levels."""
    top = high if brightest is None else brightest
    return {"0": low, "1": low, "50": low, "99": high, "99.9": high, "100": top}


@pytest.mark.parametrize(
    ("dark", "light", "lit"),
    [
        # Half of the dark frame's spread of 10; one grey value if the spread is 0.
        pytest.param(levels(64, 74), levels(68, 78), False, id="less than half of the spread"),
        pytest.param(levels(64, 74), levels(69, 74), True, id="half of the spread"),
        pytest.param(levels(64, 64), levels(64, 64), False, id="nothing above an even frame"),
        pytest.param(levels(64, 64), levels(65, 65), True, id="one above an even frame"),
        # A highlight of 5 % of a range of 1000.
        pytest.param(levels(64, 64, 90), levels(64, 64, 140), False, id="a spark"),
        pytest.param(levels(64, 64, 90), levels(64, 64, 141), True, id="a highlight"),
    ],
)
def test_the_margin_of_light(dark: dict[str, int], light: dict[str, int], lit: bool) -> None:
    assert is_lit(light, dark, 1000) == lit


@pytest.mark.parametrize(
    ("lit", "dark", "rise", "least_us"),
    [
        # 60 grey values at 1000 us; three times the margin of 5 are 15 at 250 us.
        pytest.param(levels(124, 134), levels(64, 74), (60, 60, 60, 60), 250.0, id="light"),
        # 400 of 1000 at 1000 us: three times 5 % are 150 at 375 us.
        pytest.param(levels(64, 64, 464), levels(64, 64), (0, 0, 0, 400), 375.0, id="highlight"),
    ],
)
def test_how_long_an_exposure_must_show_its_light(
    lit: dict[str, int], dark: dict[str, int], rise: tuple[int, ...], least_us: float
) -> None:
    seen = SeenLight.of(1000.0, lit, dark, 1000)
    assert seen is not None
    assert seen.rise_dn == dict(zip(("50", "99", "99.9", "100"), rise, strict=True))
    assert not seen.must_show(least_us - 1, dark, 1000)
    assert seen.must_show(least_us + 1, dark, 1000)


@pytest.mark.parametrize(("level_dn", "darker"), [(64, False), (63, False), (62, True), (40, True)])
def test_a_frame_counts_as_darker_from_one_grey_value(level_dn: int, darker: bool) -> None:
    def quality(level: int) -> FrameQuality:
        return FrameQuality(0.0, levels(level, level), 0.0, float(level))

    error = rejection(
        LIGHT, quality(level_dn), dark=quality(64), range_dn=1000, max_clipped_fraction=1.0
    )
    assert error is not None
    assert ("darker" in str(error)) == darker


@pytest.mark.parametrize(("fraction", "counts"), [(0.25, True), (0.2501, False)])
def test_the_limit_of_clipped_samples_is_that_of_the_plan(fraction: float, counts: bool) -> None:
    quality = FrameQuality(fraction, levels(100, 200), 0.0, 150.0)
    found = rejection(LIGHT, quality, dark=None, range_dn=1000, max_clipped_fraction=0.25)
    assert (found is None) == counts
