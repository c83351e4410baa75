"""Uncertainties of parameters and steps, compared with actual errors."""

import math
from dataclasses import replace

import numpy as np
import pytest

from acquisition import DataError
from calibration import EstimateError
from processing import NormalMap, integrate
from processing.roughness import (
    AREAL,
    SOURCES,
    ErrorModel,
    Limit,
    Line,
    NormalErrors,
    Resolution,
    Scales,
    applied,
    areal_parameters,
    measure_area,
    measure_profile,
    measure_step,
    read_limits,
    scale_limited,
    step_height,
)
from processing.roughness.uncertainty import quantities

PIXEL = 0.01
SIZE = 96
Y, X = np.meshgrid(np.arange(SIZE) * PIXEL, np.arange(SIZE) * PIXEL, indexing="ij")
SHARP = Resolution(PIXEL, 0.0)


def relief(amplitude, seed=0):
    """Return heights and slopes dz/dx and dz/dy of a sum of waves of at least 12 pixels."""
    rng = np.random.default_rng(seed)
    z, right, up = np.zeros((3, SIZE, SIZE))
    for _ in range(30):
        k = 2 * np.pi / (PIXEL * rng.uniform(12, 30))
        turn, phase = rng.uniform(0, 2 * np.pi, 2)
        a, b = k * np.cos(turn), k * np.sin(turn)
        at = a * X - b * Y + phase
        z += np.sin(at)
        right += a * np.cos(at)
        up += b * np.cos(at)
    factor = amplitude / z.std()
    return factor * z, factor * right, factor * up


def measured(amplitude, seed, *, sigma_deg=1.0, common_deg=0.0, area=None):
    """Measure a surface whose normals have errors."""
    rng = np.random.default_rng([seed, 1])
    z, right, up = relief(amplitude)
    vectors = np.stack([-right, -up, np.ones_like(z)], axis=-1)
    vectors /= np.linalg.norm(vectors, axis=2, keepdims=True)
    scale = math.radians(common_deg) / math.sqrt(2)
    vectors = vectors @ (np.eye(3) + scale * rng.standard_normal((3, 3))).T
    own = math.sqrt(sigma_deg**2 - common_deg**2)
    vectors += math.radians(own) / math.sqrt(2) * rng.standard_normal(vectors.shape)
    normals = NormalMap.from_vectors(vectors)
    heights = integrate(normals, pixel_mm=PIXEL, discontinuity=False).height
    stated = np.full(z.shape, sigma_deg, np.float32)
    errors = ErrorModel(NormalErrors(normals.normals, stated, common_deg))
    area = np.ones(z.shape, bool) if area is None else area
    scales = Scales("plane", 0.05, 0.0)
    found = measure_area(heights, area, SHARP, scales, errors)
    exact = Resolution(PIXEL, 0.0)
    return found, areal_parameters(scale_limited(z, area, scales, exact), PIXEL)


CHECKED = ("Sa", "Sq", "Sz", "Sdq", "Sdr", "Sku", "Sal", "Sk")
ERRORS = {
    "noise": {"sigma_deg": 1.5},
    "lights": {"sigma_deg": 1.0, "common_deg": 0.98},
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ERRORS)
def test_intervals_contain_the_truth(kind):
    runs = [measured(0.0005, seed, **ERRORS[kind]) for seed in range(24)]
    ratios = {
        name: np.array(
            [
                (found.quantities[name].value - truth[name]) / found.quantities[name].sigma
                for found, truth in runs
            ]
        )
        for name in CHECKED
    }
    within = {name: np.mean(np.abs(z) <= 2) for name, z in ratios.items()}
    assert min(within.values()) >= 0.8, within
    # The intervals are not wide without a reason.
    assert 0.5 < np.sqrt(np.mean(ratios["Sq"] ** 2)) < 1.3


def test_noise_is_removed_from_parameters_and_shown():
    found, truth = measured(0.0003, 0, sigma_deg=3.0)
    height = found.quantities["Sq"]
    assert abs(height.value - truth["Sq"]) < 2 * height.sigma < 2 * (height.measured - height.value)
    assert set(height.budget) == set(SOURCES) - {"known heights"}
    assert height.sigma == pytest.approx(float(height.result.std_dev), rel=1e-6)


def test_a_flat_surface_with_noise_is_flat():
    found, _ = measured(1e-9, 0, sigma_deg=1.0)
    height = found.quantities["Sq"]
    assert height.value <= 2 * height.sigma
    assert height.value < 0.1 * height.measured
    assert any("is noise" in doubt for doubt in height.doubts)


def test_deviations_that_the_curl_does_not_show_are_not_removed():
    found, truth = measured(0.002, 0, sigma_deg=0.2)
    rough = found.quantities["Sq"]
    # The same normals with deviations that are ten times as large: errors of the model.
    vectors = NormalMap.from_vectors(
        np.stack([*(-one for one in relief(0.002)[1:]), np.ones((SIZE, SIZE))], axis=-1)
    )
    heights = integrate(vectors, pixel_mm=PIXEL, discontinuity=False).height
    errors = NormalErrors(vectors.normals, np.full((SIZE, SIZE), 2, np.float32), 0.0)
    assert errors.noise_share < 0.2
    area = np.ones((SIZE, SIZE), bool)
    doubtful = measure_area(heights, area, SHARP, Scales("plane", 0.05, 0.0), ErrorModel(errors))
    assert doubtful.quantities["Sq"].value == pytest.approx(truth["Sq"], rel=0.01)
    assert doubtful.quantities["Sq"].budget["model"] > rough.budget["model"]


def test_results_of_one_recording_are_correlated():
    left, right = np.zeros((2, SIZE, SIZE), bool)
    left[:, :44], right[:, 52:] = True, True
    z, slope_x, slope_y = relief(0.001)
    vectors = np.stack([-slope_x, -slope_y, np.ones_like(z)], axis=-1)
    normals = NormalMap.from_vectors(vectors)
    heights = integrate(normals, pixel_mm=PIXEL, discontinuity=False).height
    model = ErrorModel(NormalErrors(normals.normals, np.full(z.shape, 1, np.float32), 1.0), 0.01)
    scales = Scales("plane", 0.05, 0.0)
    one, other = (
        measure_area(heights, area, SHARP, scales, model).quantities["Sq"].result
        for area in (left, right)
    )
    # A part of the errors cancels in the ratio, but not in a ratio of independent ones.
    ratio = one / other
    independent = math.hypot(one.std_dev / one.nominal_value, other.std_dev / other.nominal_value)
    assert ratio.std_dev / ratio.nominal_value < 0.7 * independent


def test_without_errors_there_is_no_uncertainty():
    z, *_ = relief(0.001)
    found = measure_area(z, np.ones(z.shape, bool), SHARP, Scales("plane", 0.05, 0.0))
    assert math.isnan(found.quantities["Sq"].sigma)
    assert found.quantities["Sq"].value == found.quantities["Sq"].measured


def test_an_even_texture_has_no_direction():
    z, *_ = relief(0.001)
    area, scales = np.ones(z.shape, bool), Scales("plane", 0.05, 0.0)
    assert measure_area(z, area, SHARP, scales).quantities["Std"].doubts
    stripes = 0.001 * np.sin(2 * np.pi * X / 0.13) + 0.05 * z
    assert not measure_area(stripes, area, SHARP, scales).quantities["Std"].doubts


def groove(depth=0.05, width=60, flank=10, count=240, slope=0.001):
    """Return a groove with flanks that rise as a cosine."""
    at = np.arange(count, dtype=float)

    def edge(place):
        t = np.clip((at - place) / flank + 0.5, 0, 1)
        return (1 - np.cos(np.pi * t)) / 2

    return slope * at - depth * (edge(120 - width / 2) - edge(120 + width / 2))


def test_the_depth_of_a_groove():
    found = step_height(groove())
    assert found.kind == "groove"
    assert found.height == pytest.approx(-0.05, rel=1e-6)
    assert found.width_px == pytest.approx(60, abs=0.2)
    assert found.flank_px == pytest.approx(2 / np.pi * 10, rel=0.05)
    assert step_height(-groove()).height == pytest.approx(0.05, rel=1e-6)


def test_the_height_of_a_step():
    at = np.arange(200.0)
    t = np.clip((at - 90) / 12 + 0.5, 0, 1)
    heights = 0.002 * at + 0.03 * (1 - np.cos(np.pi * t)) / 2
    found = step_height(heights)
    assert (found.kind, math.isnan(found.width_px)) == ("step", True)
    assert found.height == pytest.approx(0.03, rel=1e-6)
    assert step_height(heights[::-1]).height == pytest.approx(-0.03, rel=1e-6)


def plate(flank_px, height=0.05, size=(60, 200)):
    """Return normals of a plate with a step up to the right."""
    at = np.arange(size[1], dtype=float)
    t = np.clip((at - 100) / flank_px + 0.5, 0, 1)
    slope = height * np.pi / 2 * np.sin(np.pi * t) / flank_px / PIXEL
    vectors = np.stack([-slope, 0 * slope, np.ones_like(slope)], axis=-1)
    return np.broadcast_to(vectors, (*size, 3))


def test_a_resolved_step_is_measured_and_an_unresolved_one_refused():
    line = Line(40, 30, 160, 30, 5)
    for flank, resolved in ((20, True), (4, False)):
        normals = NormalMap.from_vectors(plate(flank))
        heights = integrate(normals, pixel_mm=PIXEL, discontinuity=False).height
        stated = np.full(heights.shape, 0.3, np.float32)
        errors = ErrorModel(NormalErrors(normals.normals, stated, 0.1))
        if resolved:
            found = measure_step(heights, line, Resolution(PIXEL), errors).quantities["d"]
            assert abs(found.value - 50) < 2 * found.sigma
        else:
            with pytest.raises(DataError, match=r"the flank is .* wide.*known heights"):
                measure_step(heights, line, Resolution(PIXEL), errors)
            known = measure_step(heights, line, Resolution(PIXEL), errors, known_mm=0.02)
            depth = known.quantities["d"]
            assert depth.budget["known heights"] == pytest.approx(20 * math.sqrt(2))
            assert depth.sigma == pytest.approx(depth.result.std_dev)


LINES = {
    "too short": (Line(10, 10, 20, 10), "too short"),
    "outside": (Line(10, 10, 300, 10), "leaves the image"),
    "wide line outside": (Line(10, 1, 90, 1, 9), "leaves the image"),
    "hole": (Line(10, 50, 90, 50), "crosses a hole or a jump"),
}


@pytest.mark.parametrize("name", LINES)
def test_lines_that_cannot_be_measured(name):
    heights, *_ = relief(0.001)
    heights[48:52, 40:50] = np.nan
    line, message = LINES[name]
    for measure in (measure_profile, measure_step):
        with pytest.raises(DataError, match=message):
            measure(heights, line, Resolution(PIXEL))


def test_a_flat_line_has_no_step():
    with pytest.raises(EstimateError, match="flat"):
        measure_step(np.zeros((SIZE, SIZE)), Line(5, 5, 80, 5), Resolution(PIXEL))


def test_lines_at_any_angle_see_the_same_profile():
    wave = 0.001 * np.sin(2 * np.pi * (X + Y) / 0.4)
    found = measure_profile(wave, Line(5, 5, 85, 85), Resolution(PIXEL), Scales("none", 0.05, 0.0))
    assert found.quantities["RSm"].value == pytest.approx(0.4 / np.sqrt(2), rel=0.01)
    assert found.quantities["Rq"].value == pytest.approx(1 / np.sqrt(2), rel=0.05)


def quantity(value, sigma, **options):
    z, *_ = relief(0.001)
    found = measure_area(z, np.ones(z.shape, bool), SHARP, Scales("plane", 0.05, 0.0))
    return replace(found.quantities["Sq"], result=value, budget={"noise": sigma}, **options)


DECISIONS = [
    (1.0, 0.1, {"most": 1.3}, "conforms"),
    (1.0, 0.1, {"most": 1.1}, "undecided"),
    (1.0, 0.1, {"most": 0.7}, "exceeded"),
    (1.0, 0.1, {"least": 1.3}, "exceeded"),
    (1.0, 0.1, {"least": 0.9}, "undecided"),
    (1.0, 0.1, {"least": 0.7, "most": 1.25}, "conforms"),
    (1.0, math.nan, {"most": 5}, "undecided"),
]


@pytest.mark.parametrize(("value", "sigma", "limit", "answer"), DECISIONS)
def test_the_uncertainty_counts_at_limits(value, sigma, limit, answer):
    assert Limit(parameter="Sq", **limit).judge(quantity(value, sigma)) == answer


def test_doubts_about_a_recording_are_those_of_all_parameters():
    z, *_ = relief(0.001)
    normals = NormalMap.from_vectors(np.tile([0.0, 0.0, 1.0], (SIZE, SIZE, 1))).normals
    stated = np.full((SIZE, SIZE), 0.5, np.float32)
    errors = ErrorModel(NormalErrors(normals, stated, 0.1), doubts=("why",))
    area, scales = np.ones(z.shape, bool), Scales("plane", 0.05, 0.0)
    found = measure_area(z, area, SHARP, scales, errors).quantities["Sq"]
    assert found.doubts == ("why",)
    assert Limit(parameter="Sq", most=1e6).judge(found) == "undecided"


def test_what_is_not_assured_proves_nothing():
    doubtful = quantity(1.0, 0.01, doubts=("why",))
    assert Limit(parameter="Sq", most=2).judge(doubtful) == "undecided"


FILES = {
    "unknown parameter": ('[[limit]]\nparameter = "Sx"\nmost = 1\n', "Sx is not a parameter"),
    "no limit": ('[[limit]]\nparameter = "Sa"\n', "neither least nor most"),
    "turned round": ('[[limit]]\nparameter = "Sa"\nleast = 2\nmost = 1\n', "least is above most"),
    "other key": ('[[limit]]\nparameter = "Sa"\nmax = 1\n', "max"),
    "empty": ("", "limit"),
    "not TOML": ("[[limit", "TOML"),
}


@pytest.mark.parametrize("name", FILES)
def test_limit_files_that_are_refused(tmp_path, name):
    text, message = FILES[name]
    file = tmp_path / "limits.toml"
    file.write_text(text)
    with pytest.raises(DataError, match=message):
        read_limits(file)


def test_limits_apply_to_regions(tmp_path):
    file = tmp_path / "limits.toml"
    file.write_text(
        '[[limit]]\nparameter = "Sq"\nmost = 2\n'
        '[[limit]]\nparameter = "Sq"\nregion = "rim"\nmost = 0.5\n'
    )
    values = [("rim", {"Sq": quantity(1.0, 0.1)}), ("face", {"Sq": quantity(1.5, 0.1)})]
    found = [(region, answer) for _, region, _, answer in applied(read_limits(file), values)]
    assert found == [("rim", "conforms"), ("face", "conforms"), ("rim", "exceeded")]
    with pytest.raises(DataError, match="region rim has a limit"):
        applied(read_limits(file), [("face", {"Sq": quantity(1.5, 0.1)})])


def test_a_parameter_that_errors_make_undefined_has_no_uncertainty():
    z, *_ = relief(0.001)
    normals = NormalMap.from_vectors(np.tile([0.0, 0.0, 1.0], (SIZE, SIZE, 1))).normals
    errors = ErrorModel(NormalErrors(normals, np.ones((SIZE, SIZE), np.float32), 0.0))

    def evaluate(heights, seen, other):
        return {"Sq": 1.0 if np.array_equal(heights, z) else math.nan}

    found = quantities(evaluate, evaluate(z, SHARP, False), z, SHARP, errors, AREAL)["Sq"]
    assert (found.value, math.isnan(found.sigma), found.budget) == (1.0, True, {})
    assert "undefined" in found.doubts[0]


def test_normals_without_a_deviation_count_as_uncertain():
    normals = NormalMap.from_vectors(np.tile([0.0, 0.0, 1.0], (SIZE, SIZE, 1))).normals
    stated = np.full((SIZE, SIZE), 0.5, np.float32)
    gaps = stated.copy()
    gaps[:40] = np.nan
    whole, part = (next(NormalErrors(normals, one, 0.0).noise(PIXEL, 1)) for one in (stated, gaps))
    np.testing.assert_allclose(part, whole)
