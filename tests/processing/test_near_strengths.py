"""Strengths of near lights, found together with height and shape of simulated objects."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import Calibrations, CapturePlan, Labels, read_source, record
from processing import reconstruct
from rig import RigConfig
from simulator import open_rig_seeing, render, save_truth, scene_named

LEDS = 20
PLAN = CapturePlan(repeat=False, leds=tuple(range(LEDS)), exposures_us=(9000.0,))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "stated"), [("coin", False), ("sphere", False), ("sphere", True)])
def test_near_strengths_and_normals_are_those_of_a_calibration(tmp_path, name, stated):
    """The mean height of the hemisphere, 43 mm, is far from the working plane."""
    rendering = render(scene_named(name, width=240, height=200, leds=LEDS, seed=101))
    truth = rendering.truth
    config = RigConfig(name="x", driver="simulated", leds=LEDS, settle_ms=0)
    with open_rig_seeing(rendering, config, realtime=False) as rig:
        known = Calibrations(lights=truth.lights, camera_model=truth.camera, sensor=truth.noise)
        labels = Labels(operator="Ada", object_name=name)
        record(rig, PLAN, tmp_path / "object", labels, calibrations=known)
    save_truth(tmp_path / "object" / "derived" / "truth", rendering, exposures_us=(9000.0,))
    source = read_source(tmp_path / "object")
    factors = np.exp(np.random.default_rng(102).normal(0, 0.3, LEDS))
    given = source.lights.intensities
    unknown = replace(source.lights, intensities=given / factors[:, None])
    options = {"height_mm": float(np.mean(truth.height_mm[truth.mask]))} if stated else {}
    found = reconstruct(
        replace(source, lights=unknown), semi_calibrated=True, surface=False, **options
    )
    calibrated = reconstruct(source, surface=False)
    ratio = np.log(found.strengths.lights.intensities[:, 0] / given[:, 0])
    assert np.std(ratio) < 0.03
    if not stated:
        assert np.std(ratio) < 3 * np.median(found.strengths.sigmas)
    assert found.error.mae_deg < calibrated.error.mae_deg + 0.7
