"""Figures of networks on held-out surfaces, and the correction of their deviations."""

from __future__ import annotations

import numpy as np
import pytest

import processing
from rig import no_progress
from sgp.training import HELD_OUT, fitted_deviations, judged, measure
from sgp.training.judgement import Measured


def errors_of(seed: int, count: int = 40_000) -> Measured:
    """Return errors whose deviation is not what was predicted: extrapolated at the top."""
    random = np.random.default_rng(seed)
    logs = random.normal(scale=1.5, size=count)
    logs[-count // 100 :] += 4
    predicted = np.sort(np.exp(logs))
    actual = 2 * np.minimum(predicted, 20) ** 0.8
    angles = actual * np.hypot(*random.normal(scale=np.sqrt(0.5), size=(2, count)))
    return Measured(2.0, 1.5, predicted.astype(np.float32), angles)


def test_corrected_deviations_agree_with_errors_that_were_not_used():
    known = fitted_deviations(errors_of(1))
    assert known is not None
    fresh = errors_of(2)
    raw = judged(fresh)
    assert (min(raw.actual_over_predicted), max(raw.actual_over_predicted)) < (0.5, 2)
    after = judged(Measured(2.0, 1.5, known.corrected_deg(fresh.predicted_deg), fresh.actual_deg))
    np.testing.assert_allclose(after.actual_over_predicted, 1, atol=0.06)
    assert after.change == pytest.approx(-0.25)


def test_predictions_that_are_all_the_same_are_not_corrected():
    alike = Measured(1.0, 1.0, np.full(1000, 2, np.float32), np.linspace(0, 3, 1000))
    assert fitted_deviations(alike) is None
    few = Measured(1.0, 1.0, np.array([1, 2, 3], np.float32), np.array([0.0, 0.0, 1.0]))
    known = fitted_deviations(few)
    assert known is not None
    assert min(known.actual_deg) > 0


@pytest.mark.parametrize("scale", [2, 4])
def test_the_networks_of_the_program_are_described_as_they_are(scale):
    """Some of the surfaces that were held out give what the description says about all of them."""
    model = processing.superres.read_superres_model(None, scale)
    about = model.training["held_out"]
    assert about["seeds"] == f"0 to {HELD_OUT[-1]}"
    assert model.deviations is not None
    assert about["network_deg"] < 0.85 * about["bicubic_deg"]
    ratios = about["actual_over_predicted"]
    assert 0.8 < min(ratios) < max(ratios) < 1.25
    measured = measure(model, HELD_OUT[3:6], 96, "surfaces", no_progress)
    assert measured.network_deg < measured.bicubic_deg
    assert (np.diff(measured.predicted_deg) >= 0).all()
