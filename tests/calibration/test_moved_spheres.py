"""Several recordings of the same lights, with the spheres moved between them."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import CameraModel, DataError, Setup, read_source, write_png
from calibration import EstimateError, Stack, calibrate_moved_spheres, calibrate_spheres
from calibration.spheres import check_recordings, record_setup
from calibration.spheres.spheres_beside_object import light_difference
from tests.calibration.moved import RADII_MM, masks, planes, rendered
from tests.cases import cases
from tests.quick_sample import quick


@pytest.fixture(scope="module")
def camera():
    return rendered(0).truth.camera


def error_mm(result):
    return np.linalg.norm(
        result.lights.positions_mm - rendered(0).truth.lights.positions_mm, axis=1
    ).mean()


def sigma_mm(result):
    return np.sqrt(np.trace(result.lights.errors.covariances, axis1=1, axis2=2)).mean()


@pytest.fixture(scope="module")
def both(camera):
    return calibrate_moved_spheres(
        [planes(0), planes(1)], masks=[masks(0), masks(1)], camera=camera, radius_mm=RADII_MM
    )


@pytest.mark.slow
def test_two_recordings_are_better_than_one(both, camera):
    alone = [
        calibrate_spheres(planes(k), masks=masks(k), camera=camera, radius_mm=RADII_MM)
        for k in (0, 1)
    ]
    assert [sphere.recording for sphere in both.spheres] == [0, 0, 1, 1]
    assert [sphere.radius_mm for sphere in both.spheres] == [*RADII_MM, *RADII_MM]
    assert both.used.shape == (6, 4)
    assert both.used.all()
    assert (both.lights.errors.spheres == 4).all()
    # Twice the spheres: .7 of the error, and less because they are in all four corners.
    assert error_mm(both) < 0.8 * max(map(error_mm, alone))
    assert sigma_mm(both) < 0.75 * min(map(sigma_mm, alone))
    # The lights are where they are, whichever recording is the first.
    assert error_mm(both) < 4 * sigma_mm(both)


def test_one_sphere_in_each_recording_gives_positions(camera):
    result = calibrate_moved_spheres(
        [planes(0), planes(1)],
        masks=[masks(0)[:1], masks(1)[:1]],
        camera=camera,
        radius_mm=RADII_MM[0],
    )
    assert result.lights.near
    assert "one-sphere" not in [notice.code for notice in result.warnings]
    assert error_mm(result) < 4 * sigma_mm(result)


@pytest.mark.slow
def test_spheres_are_searched_for_in_each_recording(camera, both):
    """Each ball of the set has the radius that fits its size, though one recording shows one."""
    result = calibrate_moved_spheres(
        (images for images in (planes(0), planes(1))), camera=camera, radius_mm=RADII_MM
    )
    found = [(sphere.recording, sphere.radius_mm) for sphere in result.spheres]
    assert sorted(found) == sorted((s.recording, s.radius_mm) for s in both.spheres)
    assert error_mm(result) < 4 * sigma_mm(result)


@pytest.mark.slow
def test_the_lights_may_be_in_any_order(camera, both):
    second = planes(1)[::-1]
    ids = tuple(f"L{i:02d}" for i in range(6))
    result = calibrate_moved_spheres(
        [Stack(planes(0), ids, None), Stack(second, ids[::-1], None)],
        masks=[masks(0), masks(1)],
        camera=camera,
        radius_mm=RADII_MM,
    )
    np.testing.assert_array_equal(result.lights.positions_mm, both.lights.positions_mm)


@pytest.mark.slow
def test_notices_and_errors_name_the_recording(camera):
    dark = np.full_like(planes(1), 0.2)
    options = {"camera": camera, "radius_mm": RADII_MM, "names": ["first", "moved"]}
    result = calibrate_moved_spheres([planes(0), dark], masks=[masks(0), masks(1)], **options)
    notices = [(notice.code, notice.where) for notice in result.warnings]
    assert ("sphere-without-highlight", "moved") in notices
    assert not any(where == "first" for _, where in notices)
    with pytest.raises(EstimateError, match=r"^moved: no mirror sphere found"):
        calibrate_moved_spheres([planes(0), dark], masks=[masks(0)], **options)


@pytest.mark.parametrize(
    ("stacks", "options", "says"),
    quick(
        [
            pytest.param(([],), {}, "need two or more recordings", id="one"),
            pytest.param(([], 5), {}, "recording 2 has no light L05, which", id="lights"),
            pytest.param(([], (0, 8)), {}, "recording 2 has images of 312 x 256 pixels", id="size"),
            pytest.param(([], []), {"names": ["a"] * 3}, "at most one name", id="names"),
            pytest.param(([], []), {"masks": [[]] * 3}, "one list of", id="masks"),
        ],
        every=3,
    ),
)
def test_recordings_that_do_not_fit(stacks, options, says):
    def images(change):
        values = planes(0)
        return values[:change] if isinstance(change, int) else values[:, :, change[1] :]

    given = [planes(0) if not change else images(change) for change in stacks]
    circles = [[(60.0, 80.0, 20.0)]] * len(given)
    options = {"circles": circles} | options
    if "masks" in options:
        options["circles"] = []
        options["masks"] = [masks(0), masks(0), masks(0)]
    with pytest.raises(DataError, match=says):
        calibrate_moved_spheres(given, **options)


def test_lights_of_other_names_are_named():
    assert light_difference("a", ("L00", "L01"), "b", ("L01", "L00")) == ""
    text = light_difference("a", ("L00", "L01"), "b", ("L00", "x"))
    assert text.startswith("a has no light x, which b shows")
    text = light_difference("a", ("L00", "L01"), "b", ("L00",))
    assert text.startswith("b has no light L01, which a shows")


@pytest.fixture
def source(tmp_path):
    write_png(tmp_path / "L00.png", np.full((40, 50), 700, np.uint16))
    return read_source(tmp_path, camera=model())


def model(focal_px=90.0, distance_mm=600.0, width=50):
    K = [[focal_px, 0, 24.5], [0, focal_px, 19.5], [0, 0, 1]]
    return CameraModel(K, width, 40, distance_mm)


@cases(
    ("first", "other", "says"),
    {
        "same": ({}, {}, ""),
        "as calibrated twice": ({}, {"camera": model(90.05)}, ""),
        "focal length": ({}, {"camera": model(90.3)}, "focal length 90 px"),
        "distance": ({}, {"camera": model(distance_mm=602)}, "distance 600 mm, now 602 mm"),
        "rig": ({"setup": Setup(rig="dome")}, {"setup": Setup(rig="arc")}, "dome, now arc"),
        "camera": (
            {"setup": Setup(camera_serial="1")},
            {"setup": Setup(camera_serial="2")},
            "serial number 1, now 2",
        ),
        "not stated": ({"setup": Setup(rig="dome")}, {"camera": None}, ""),
    },
)
def test_recordings_under_another_rig_or_camera(source, first, other, says):
    sources = [replace(source, **first), replace(source, path=source.path / "b", **other)]
    if not says:
        check_recordings(sources)
        return
    with pytest.raises(
        DataError, match=f"^{source.path / 'b'} differs from {source.path}: "
    ) as is_:
        check_recordings(sources)
    assert says in str(is_.value)


def test_recordings_of_other_sizes_and_lights(source, tmp_path):
    (tmp_path / "small").mkdir()
    write_png(tmp_path / "small" / "L00.png", np.full((40, 30), 700, np.uint16))
    with pytest.raises(DataError, match="has images of 30 x 40 pixels"):
        check_recordings([source, read_source(tmp_path / "small")])
    (tmp_path / "b").mkdir()
    write_png(tmp_path / "b" / "L01.png", np.full((40, 50), 700, np.uint16))
    with pytest.raises(DataError, match="has no light L01"):
        check_recordings([source, read_source(tmp_path / "b")])


@pytest.mark.slow
def test_the_record_names_the_recording_of_each_sphere(both, source):
    other = replace(source, path=source.path / "b")
    recorded = record_setup(both, source, other).lights.calibrated
    assert [sphere.recording for sphere in recorded.spheres] == [
        *[str(source.path)] * 2,
        *[str(other.path)] * 2,
    ]
