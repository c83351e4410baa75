"""Images in which a sphere is not where the other images show it, and images that show nothing."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import angle_deg, read_source, write_png
from calibration import EstimateError, calibrate_moved_spheres, calibrate_spheres, raw_stack
from calibration.spheres import Ellipse, recording
from calibration.spheres.judge.sphere_shifts import displaced
from calibration.spheres.recording import named_stack
from calibration.spheres.solve.lost_images import blank_images
from tests.calibration.conftest import codes
from tests.calibration.spheres_and_object import CIRCLES, write_recording
from tests.calibration.uneven_balls import uneven_ball
from tests.cases import cases
from tests.quick_sample import quick
from tests.real_data import DATA, needs_data


def moved(image, x_px, y_px, turn_deg=0.0):
    """Return an image that a camera has recorded after it was bumped."""
    height, width = image.shape
    by = cv2.getRotationMatrix2D((width / 2, height / 2), turn_deg, 1)
    by[:, 2] += x_px, y_px
    filled = np.where(np.isnan(image), np.float32(1), image)
    after = cv2.warpAffine(filled, by, (width, height), borderMode=cv2.BORDER_REPLICATE)
    return np.where(after >= 1, np.float32(np.nan), after)


def ball_moved(image, circle, x_px, y_px):
    """Return an image in which only the ball moved, in front of what is next to it."""
    x, y, radius = circle
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]].astype(np.float32)
    outward = np.maximum(1.06 * radius / np.maximum(np.hypot(columns - x, rows - y), 1e-6), 1)
    at = [np.float32(c + (place - c) * outward) for c, place in ((x, columns), (y, rows))]
    behind = cv2.remap(image, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    ball = np.hypot(columns - x - x_px, rows - y - y_px) < radius + 1.5
    return np.where(ball, moved(image, x_px, y_px), behind)


def ellipse(circle):
    return Ellipse(circle[:2], (circle[2], circle[2]))


CHANGES = {
    "1.2 px to the right": (1.2, 0.0),
    "1.7 px aslant": (-1.1, 1.3),
    "2 px down": (0.0, 2.0),
    "11 px": (6.0, 9.0),
    "10 px to the left": (-10.0, 2.0),
}


@pytest.mark.parametrize("seed", quick([9200, 9201, 9202], every=3))
@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES.keys())
@pytest.mark.parametrize("alone", [False, True], ids=["camera", "ball"])
def test_the_image_that_moved_is_named_with_its_shift(seed, change, alone):
    values, circle, _ = uneven_ball(seed)
    image = values[5]
    values[5] = ball_moved(image, circle, *change) if alone else moved(image, *change)
    found = displaced(values, ellipse(circle))
    assert list(found) == [5]
    # Texture behind the ball stays where it is if only the ball moves.
    assert found[5] == pytest.approx(np.hypot(*change), abs=0.7 if alone else 0.5)


@pytest.mark.slow
@given(seed=st.integers(9300, 9399))
@settings(max_examples=15)
def test_images_that_did_not_move_are_not_named(seed):
    values, circle, _ = uneven_ball(seed)
    assert displaced(values, ellipse(circle)) == {}


@pytest.mark.parametrize("size", [0.5, 3.0])
def test_small_and_large_balls(size):
    """Large ones are compared in smaller images; the shifts are in pixels of the large ones."""
    values, circle, _ = uneven_ball(9203)
    values[2] = moved(values[2], -4.0, 3.0)
    filled = np.where(np.isnan(values), np.float32(1), values)
    large = [
        cv2.resize(one, None, fx=size, fy=size, interpolation=cv2.INTER_CUBIC) for one in filled
    ]
    x, y = ((at + 0.5) * size - 0.5 for at in circle[:2])
    radius = circle[2] * size
    found = displaced(np.array(large, np.float32), Ellipse.circle(x, y, radius))
    assert list(found) == [2]
    assert found[2] == pytest.approx(5 * size, abs=0.1 * 5 * size)


def test_a_turned_camera_moves_a_ball_beside_the_middle():
    values, circle, _ = uneven_ball(9204)
    # The middle of the image is (140, 120) px.
    away = np.hypot(circle[0] - 140, circle[1] - 120)
    turn = np.degrees(4 / away)
    values[1] = moved(values[1], 0, 0, turn)
    found = displaced(values, ellipse(circle))
    assert list(found) == [1]
    assert found[1] == pytest.approx(4, abs=0.6)


def test_several_images_that_moved_differently():
    values, circle, _ = uneven_ball(9205, lights=12)
    for k, change in {2: (4, 0), 3: (4, 0), 7: (-3, 5), 11: (0, 9)}.items():
        values[k] = moved(values[k], *change)
    assert sorted(displaced(values, ellipse(circle))) == [2, 3, 7, 11]


def test_most_images_decide_where_the_sphere_is():
    values, circle, _ = uneven_ball(9206, lights=10)
    values[:6] = [moved(image, 5, 0) for image in values[:6]]
    assert sorted(displaced(values, ellipse(circle))) == [6, 7, 8, 9]


def test_three_images_show_which_one_moved_and_two_do_not():
    values, circle, _ = uneven_ball(9207)
    values[1] = moved(values[1], 6, 0)
    assert list(displaced(values[:3], ellipse(circle))) == [1]
    assert displaced(values[:2], ellipse(circle)) == {}


def test_small_shifts_need_many_images_and_tiny_balls_show_none():
    values, circle, _ = uneven_ball(9207)
    values[1] = moved(values[1], 1.0, 0)
    assert list(displaced(values, ellipse(circle))) == [1]
    assert displaced(values[:7], ellipse(circle)) == {}
    scale = 11 / circle[2]
    tiny = np.array([cv2.resize(moved(v, 0, 0), None, fx=scale, fy=scale) for v in values])
    tiny[1] = np.roll(tiny[1], 4, axis=1)
    x, y = ((at + 0.5) * scale - 0.5 for at in circle[:2])
    assert displaced(np.nan_to_num(tiny, nan=1.0), Ellipse.circle(x, y, 11.0)) == {}


@pytest.mark.parametrize("centre", [(-5.0, 60.0), (100.0, 900.0)])
def test_an_outline_beyond_the_frame_shows_nothing(centre):
    values, _, _ = uneven_ball(9208)
    assert displaced(values, Ellipse(centre, (50.0, 50.0))) == {}


CIRCLED = 9210


def calibrated(values, circle):
    return calibrate_spheres(values, circles=[circle])


def test_the_light_of_a_bumped_image_is_left_out_as_if_the_image_were_not_there():
    values, circle, directions = uneven_ball(CIRCLED, lights=12)
    bumped = values.copy()
    bumped[7] = moved(values[7], 6, 9)
    result = calibrated(bumped, circle)
    without = calibrated(np.delete(values, 7, axis=0), circle)
    (notice,) = [one for one in result.warnings if one.code == "image-displaced"]
    assert notice.text.startswith("light L07: the sphere at (")
    assert "px is 11 px away from where the other images show it" in notice.text
    assert "the light is left out: record it again" in notice.text
    assert result.lights.ids == tuple(f"L{k:02d}" for k in range(12) if k != 7)
    np.testing.assert_array_equal(result.lights.directions, without.lights.directions)
    true = np.delete(directions, 7, axis=0)
    assert angle_deg(result.lights.unit_directions, true).max() < 1


def test_two_of_eight_bumped_images_are_refused_with_their_names():
    values, circle, _ = uneven_ball(CIRCLED)
    for k in (1, 6):
        values[k] = moved(values[k], 6, 9)
    with pytest.raises(EstimateError, match=r"light L01: .* away .*; light L06: .* away") as caught:
        calibrated(values, circle)
    assert caught.value.lights == ("L01", "L06")
    assert caught.value.spheres[0] == pytest.approx(circle, abs=3)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.slow
def test_a_camera_that_was_bumped_in_between_gives_one_short_line():
    values, circle, _ = uneven_ball(CIRCLED, lights=12)
    values[7:] = [moved(image, 6, 9) for image in values[7:]]
    with pytest.raises(EstimateError, match=r"light L09: .*; and 2 more: record them") as caught:
        calibrated(values, circle)
    assert caught.value.lights == ("L07", "L08", "L09", "L10", "L11")


BLANK = {
    "black": (0.0, "light L03: the image is black; the light is left out: record it again"),
    "black, with noise": (0.002, "light L03: the image is black; the light is left out"),
    "white": (np.nan, "light L03: the image is completely saturated; the light is left out"),
}


@pytest.mark.parametrize(("value", "says"), quick(BLANK.values(), every=3), ids=BLANK.keys())
def test_a_black_or_white_image_costs_its_light_only(value, says):
    values, circle, _ = uneven_ball(CIRCLED, lights=12)
    blank = values.copy()
    blank[3] = value
    result = calibrated(blank, circle)
    assert says in " ".join(map(str, result.warnings))
    assert "image-blank" in codes(result)
    without = calibrated(np.delete(values, 3, axis=0), circle)
    np.testing.assert_array_equal(result.lights.directions, without.lights.directions)
    assert "L03" not in result.lights.ids


def test_blank_images_of_files_are_those_of_their_values(tmp_path):
    write_recording(tmp_path)
    write_png(tmp_path / "L02.png", np.zeros((200, 300), np.uint16))
    write_png(tmp_path / "L05.png", np.full((200, 300), 65535, np.uint16))
    stack = raw_stack(read_source(tmp_path))
    for images in (stack, replace(stack, peaks=()), named_stack(stack.values[:, :, :])):
        lost = blank_images(images)
        assert (lost.black, lost.white) == ((2,), (5,))
    assert blank_images(stack.take([0, 5, 7])).white == (1,)
    assert blank_images(named_stack(np.full((3, 4, 5), np.nan, np.float32))).lights == []


def recording_of(folder, **moves):
    """Return the recording with two balls, in which some images of balls are moved."""
    write_recording(folder)
    values = np.array(raw_stack(read_source(folder)).values[:, :, :])
    for name, (k, change) in moves.items():
        circle = CIRCLES[int(name[-1])]
        values[k] = ball_moved(values[k], circle, *change)
    return values


@pytest.mark.slow
def test_one_of_three_balls_that_moved_loses_its_highlight_only(tmp_path):
    values = recording_of(tmp_path)
    # A third ball: the first one once more, elsewhere.
    part = values[:, 25:95, 15:85].copy()
    values[:, 125:195, 15:85] = part
    circles = [*CIRCLES, (50.0, 160.0, 30.0)]
    values[4] = ball_moved(values[4], circles[2], 4, 0)
    result = calibrate_spheres(values, circles=circles)
    assert len(result.lights) == 8
    (notice,) = [one for one in result.warnings if one.code == "sphere-displaced"]
    assert notice.text.startswith("light L04: the sphere at (50, 160) px is 4 px away from where")
    assert np.argwhere(~np.isfinite(result.highlights_px[..., 0])).tolist() == [[4, 2]]
    # The outlines are those of the other images.
    without = calibrate_spheres(np.delete(values, 4, axis=0), circles=circles)
    assert [s.outline for s in result.spheres] == [s.outline for s in without.spheres]


def test_half_of_the_balls_are_enough_to_doubt_an_image(tmp_path):
    values = recording_of(tmp_path, ball0=(4, (4, 0)))
    result = calibrate_spheres(values, circles=CIRCLES)
    assert "L04" not in result.lights.ids
    assert "image-displaced" in codes(result)


@pytest.mark.slow
def test_another_recording_shows_the_light_of_a_bumped_image(tmp_path):
    good, bad = recording_of(tmp_path), recording_of(tmp_path, ball0=(4, (4, 0)), ball1=(4, (4, 0)))
    result = calibrate_moved_spheres([bad, good], circles=[CIRCLES, CIRCLES])
    assert len(result.lights) == 8
    (notice,) = [one for one in result.warnings if one.code == "image-displaced"]
    assert notice.where == "recording 1"
    assert "the image does not count: record it again" in notice.text
    assert result.used[4].tolist() == [False, False, True, True]


def test_a_refused_recording_of_several_names_its_images_and_spheres(tmp_path):
    good = recording_of(tmp_path)
    bad = recording_of(tmp_path, ball0=(4, (4, 0)), ball1=(6, (4, 0)))
    with pytest.raises(EstimateError, match=r"^second: light L04: .*; light L06: ") as caught:
        calibrate_moved_spheres([good, bad], names=["first", "second"], circles=[CIRCLES] * 2)
    assert caught.value.lights == ("L04", "L06")
    assert len(caught.value.spheres) == 2


def test_one_lost_image_of_few_is_refused_in_the_singular():
    values, circle, _ = uneven_ball(CIRCLED)
    values[2] = 0
    with pytest.raises(EstimateError, match=r"image is black: record it again, or leave it out$"):
        calibrated(values[:4], circle)


@cases(
    ("shown", "says"),
    {
        "one": ((3,), "light L08 is left out: record them again"),
        "both": pytest.param(
            (3, 8), "the images do not count: record them again", marks=pytest.mark.slow
        ),
        "none": pytest.param(
            (), "the lights are left out: record them again", marks=pytest.mark.slow
        ),
    },
)
def test_what_other_recordings_show_of_blank_images(shown, says):
    values, circle, _ = uneven_ball(CIRCLED, lights=16)
    blank, other = values.copy(), values.copy()
    blank[[3, 8]] = 0
    other[[k for k in (3, 8) if k not in shown]] = 0
    result = calibrate_moved_spheres([blank, other], circles=[[circle]] * 2)
    (notice,) = [one for one in result.warnings if one.where == "recording 1" and says in one.text]
    assert notice.text.startswith("lights L03, L08: the images are black; ")
    assert [k for k in ("L03", "L08") if k in result.lights.ids] == [f"L{k:02d}" for k in shown]


@pytest.mark.slow
def test_images_in_each_of_which_another_ball_moved_show_the_outlines(tmp_path, monkeypatch):
    """No image is left in which none of three balls moved."""
    values = recording_of(tmp_path)[:3]
    values[:, 125:195, 15:85] = values[:, 25:95, 15:85].copy()
    moves = iter([{0: 4.0}, {1: 4.0}, {2: 4.0}] * 2)
    monkeypatch.setattr(recording, "displaced", lambda *_: next(moves))
    result = calibrate_spheres(values, circles=[*CIRCLES, (50.0, 160.0, 30.0)])
    assert np.isfinite(result.highlights_px[..., 0]).tolist() == (~np.eye(3, dtype=bool)).tolist()
    assert codes(result).count("sphere-displaced") == 3


@pytest.fixture(scope="module")
def chrome():
    """Return the images and the outline of a ball that moved in none of them."""
    source = read_source(DATA / "uw" / "chrome")
    values = np.array(raw_stack(source).values[:, :, :])
    rows, columns = np.nonzero(source.mask)
    outline = Ellipse((columns.mean(), rows.mean()), (119.0, 119.0))
    assert displaced(values, outline) == {}
    return values, outline


# Images 4 and 5 show hardly any edge of the ball.
@needs_data
@pytest.mark.parametrize("light", quick([0, 1, 3, 6, 7, 8, 9, 10, 11], every=3))
@pytest.mark.parametrize("change", [(6.0, 9.0), (-2.0, 1.5)], ids=["11 px", "2.5 px"])
def test_the_real_ball_in_a_bumped_image(chrome, light, change):
    values, outline = chrome
    bumped = values.copy()
    bumped[light] = moved(values[light], *change)
    found = displaced(bumped, outline)
    assert list(found) == [light]
    assert found[light] == pytest.approx(np.hypot(*change), abs=1)
