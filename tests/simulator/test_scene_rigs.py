"""The simulated rig with rendered scenes: frames equal the rendering."""

import numpy as np
import pytest

from rig import RigConfig, RigConfigError
from simulator import open_rig, open_rig_seeing, render, scene_named


def _config(leds=4, **options):
    return RigConfig(name="bench 1", driver="simulated", leds=leds, settle_ms=0.0, options=options)


def _expected(rendering, electrons):
    noise = rendering.truth.noise
    grey = electrons / noise.electrons_per_dn + noise.black_level_dn
    return np.clip(grey, 0, noise.white_level_dn)


@pytest.fixture(scope="module")
def small():
    return render(scene_named("coin-with-spheres", width=64, height=48, leds=3))


def test_frames_equal_the_rendering(small):
    with open_rig_seeing(small, noisy=False) as rig:
        lit, dark = rig.shoot(1, exposure_us=12_000.0), rig.shoot(None, exposure_us=12_000.0)
    np.testing.assert_allclose(
        lit.frame.pixels, _expected(small, 12_000 * (small.planes[1] + small.ambient)), atol=0.51
    )
    np.testing.assert_allclose(
        dark.frame.pixels, _expected(small, 12_000 * small.ambient), atol=0.51
    )


def test_a_short_bracket_measures_the_highlights(small):
    """Mirrored LEDs saturate at the exposure time of the coin, but not at a short one."""
    spheres = small.truth.sphere_masks.any(axis=0)
    # At this size only some highlights are wide enough to saturate.
    led = int(np.argmax(small.planes[:, spheres].max(axis=1)))
    with open_rig_seeing(small, noisy=False) as rig:
        long = rig.shoot(led, exposure_us=40_000.0).frame.pixels
        short = rig.shoot(led, exposure_us=4_000.0).frame.pixels
    white = small.truth.noise.white_level_dn
    assert long[spheres].max() == white
    assert white / 5 < short[spheres].max() < white


def test_driver_opens_with_its_options():
    config = _config(scene="spheres", width=48, height=32, seed=2, noise=False, realtime=False)
    rendering = render(scene_named("spheres", width=48, height=32, leds=4, seed=2))
    with open_rig(config) as rig:
        assert (rig.camera.info.width, rig.camera.info.height) == (48, 32)
        dark = rig.shoot(None, exposure_us=10_000.0).frame.pixels
    np.testing.assert_allclose(dark, _expected(rendering, 10_000 * rendering.ambient), atol=0.51)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        pytest.param({"scene": "teapot"}, "bench 1: unknown scene 'teapot'", id="scene"),
        pytest.param({"widht": 64}, "unknown option 'widht'; known are scene", id="misspelt"),
        pytest.param({"width": 0}, "option 'width': .* not 0", id="zero-width"),
        pytest.param({"height": "tall"}, "option 'height'", id="text"),
        pytest.param({"seed": -1}, "option 'seed'", id="seed"),
        pytest.param({"noise": "no"}, "option 'noise'", id="not-a-truth-value"),
    ],
)
def test_an_invalid_option_is_reported_in_one_line(options, message):
    with pytest.raises(RigConfigError, match=message) as caught:
        open_rig(_config(**options))
    assert "\n" not in str(caught.value)


def test_led_counts_must_agree(small):
    with pytest.raises(RigConfigError, match="4 LEDs, its scene has 3"):
        open_rig_seeing(small, _config(leds=4))
