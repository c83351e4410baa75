"""The search for spheres: edges, circles, the choice among candidates, and the messages."""

import cv2
import numpy as np
import pytest

from calibration import EstimateError
from calibration.spheres import Ellipse, Highlights, TracedOutline
from calibration.spheres.highlights.spots import reduce_stack, spot_clusters
from calibration.spheres.propose import edge_search
from calibration.spheres.propose import sphere_selection as search
from calibration.spheres.propose.edge_search import (
    _centres,
    _edges,
    _has_highlights,
    _radii,
    _refined,
    circular_edges,
    expected,
    mirroring,
    overlap,
    round_outlines,
    spheres_by_edges,
)
from tests.calibration.test_sphere_parts import SMALL, image_of
from tests.cases import cases


@pytest.mark.parametrize(("apart", "over"), [(29.9, True), (30.1, False)])
def test_circles_overlap_if_one_contains_the_centre_of_the_other(apart, over):
    large = Ellipse.circle(100.0, 50.0, 30.0)
    for dx, dy in ((apart, 0), (0, apart), (-0.6 * apart, 0.8 * apart)):
        small = Ellipse((100.0 + dx, 50.0 + dy), (5.0, 5.0))
        assert overlap(large, small) == overlap(small, large) == over


@pytest.mark.parametrize(
    ("radius", "radii", "right"),
    [
        (100, (), True),
        (100, (100, 50), True),
        (57.4, (100, 50), True),
        (57.6, (100, 50), False),
        (42.6, (100, 50), True),
        (42.4, (100, 50), False),
    ],
)
def test_a_circle_has_an_expected_radius_to_15_percent(radius, radii, right):
    assert expected(Ellipse((0.0, 0.0), (float(radius), float(radius))), radii) == right


def test_radii_are_those_of_edges_that_face_the_centre():
    angles = np.arange(0, 2 * np.pi, 0.01)
    side = np.column_stack([np.cos(angles), np.sin(angles)])
    half = side[angles < np.pi]
    edges = np.concatenate([50 + 20.3 * side, 50 + 35.3 * half, 50 + 27.3 * side])
    # The gradients of the last circle are tangential.
    facing = np.concatenate([side, -half, side[:, ::-1] * [1, -1]])
    circles = sorted(_radii(edges, facing, (50.0, 50.0), 45.0))
    assert [radius for radius, _ in circles] == pytest.approx([20.3, 35.3], abs=1.3)
    assert [coverage for _, coverage in circles] == pytest.approx([1.0, 0.5], abs=0.03)


def test_edges_within_18_degrees_of_the_radius_face_the_centre():
    angles = np.arange(0, 2 * np.pi, 0.01)
    for degrees, counted in ((0, True), (17, True), (-17, True), (163, True), (20, False)):
        facing = angles + np.radians(degrees)
        side, facing = (np.column_stack([np.cos(t), np.sin(t)]) for t in (angles, facing))
        circles = _radii(50 + 20.3 * side, facing, (50.0, 50.0), 45.0)
        assert len(circles) == counted


@pytest.mark.parametrize(("radius", "counted"), [(7.9, 0), (8.4, 1), (44.9, 1), (45.1, 0)])
def test_radii_are_between_8_px_and_the_largest(radius, counted):
    angles = np.arange(0, 2 * np.pi, 0.01)
    side = np.column_stack([np.cos(angles), np.sin(angles)])
    assert len(_radii(50 + radius * side, side, (50.0, 50.0), 45.0)) == counted


def test_edges_in_a_band_of_three_pixels_are_one_circle_in_its_middle():
    angles = np.arange(0, 2 * np.pi, 0.002)
    radii = 20.5 + (36 * angles / np.pi).astype(int) % 3
    side = np.column_stack([np.cos(angles), np.sin(angles)])
    ((radius, coverage),) = _radii(50 + radii[:, None] * side, side, (50.0, 50.0), 45.0)
    assert radius == 21.5
    assert coverage == 1


@pytest.mark.parametrize(("smaller", "separate"), [(25.5, True), (27.5, False)])
def test_circles_five_pixels_apart_are_separate(smaller, separate):
    angles = np.arange(0, 2 * np.pi, 0.01)
    side = np.column_stack([np.cos(angles), np.sin(angles)])
    part = side[angles < 4]
    edges, facing = np.concatenate([30.5 * side, smaller * part]), np.concatenate([side, part])
    assert len(_radii(50 + edges, facing, (50.0, 50.0), 45.0)) == 1 + separate


def ring(x, y, radius, sign=1):
    """Return edge pixels on a circle, and gradients away from its centre, or toward it."""
    angles = np.arange(0, 2 * np.pi, 1 / radius)
    side = np.column_stack([np.cos(angles), np.sin(angles)])
    edges = np.rint([x, y] + radius * side)
    return edges, sign * side


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("radius", [10, 30])
@pytest.mark.parametrize("centre", [(0, 40), (119, 40), (60, 0), (60, 89), (55, 42), (0, 0)])
def test_edges_vote_for_the_centre_of_a_circle(centre, radius, sign):
    """A centre may be in the first or last row or column; other peaks are apart from it."""
    edges, facing = ring(*centre, radius, sign)
    inside = np.all((edges >= 0) & (edges < (120, 90)), axis=1)
    peaks = np.array(_centres(edges[inside], facing[inside], (90, 120), 45.0))
    assert peaks[0] == pytest.approx(centre, abs=0.5)
    gaps = np.linalg.norm(peaks[:, None] - peaks, axis=2) + 100 * np.eye(len(peaks))
    assert gaps.min() > 4


def test_two_circles_have_two_centres():
    edges, facing = map(np.concatenate, zip(ring(40, 40, 30), ring(85, 50, 20, -1), strict=True))
    peaks = sorted(_centres(edges, facing, (90, 120), 45.0)[:2])
    np.testing.assert_allclose(peaks, [(40, 40), (85, 50)], atol=1)
    assert _centres(np.zeros((0, 2)), np.zeros((0, 2)), (90, 120), 45.0) == []


def discs(shape, *circles, inside=0.7, outside=0.2):
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    image = np.full(shape, outside)
    for x, y, radius in circles:
        cover = np.clip(radius + 0.5 - np.hypot(columns - x, rows - y), 0, 1)
        image += (inside - outside) * cover
    return image.astype(np.float32)


@pytest.mark.parametrize(("inside", "sign"), [(0.7, -1), (0.05, 1)], ids=["bright", "dark"])
def test_edges_of_a_disc_are_one_pixel_wide_and_face_its_centre(inside, sign):
    image = discs((90, 120), (55.3, 42.6, 30.0), inside=inside)
    edges, facing = _edges(np.log(image))
    offset = edges - (55.3, 42.6)
    radius = np.linalg.norm(offset, axis=1)
    assert np.abs(radius - 30).max() < 1.1
    assert np.sum(facing * offset, axis=1) == pytest.approx(sign * radius, rel=0.02)
    assert 150 < len(edges) < 240  # 188 px


@pytest.mark.parametrize("turned", [False, True], ids=["columns", "rows"])
@pytest.mark.parametrize(
    ("slope", "step", "seen"),
    [
        pytest.param(0.0, 0.002, False, id="faint"),
        pytest.param(0.0, 0.0045, True, id="just visible"),
        pytest.param(0.01, 0.03, False, id="less than three times the slope"),
        pytest.param(0.01, 0.07, True, id="more than three times the slope"),
    ],
)
def test_an_edge_exceeds_three_times_the_usual_gradient(slope, step, seen, turned):
    row = slope * np.arange(80.0) + step * (np.arange(80) >= 40)
    image = np.tile(row, (60, 1)).astype(np.float32)
    edges, facing = _edges(image.T.copy() if turned else image)
    across = 1 if turned else 0
    assert len(edges) == (60 if seen else 0)
    assert set(edges[:, across]) <= {39.0, 40.0}
    np.testing.assert_allclose(facing[:, across], 1.0, atol=1e-3)


def test_the_strongest_edges_are_kept():
    """One of 21 stripes has twice the contrast; the others have 24000 edges."""
    image = np.zeros((610, 500), np.float32)
    for k in range(21):
        image[:, 20 * k + 40 : 20 * k + 50] = 2 if k == 20 else 1
    edges, _ = _edges(image)
    assert len(edges) == 20000
    assert np.sum(edges[:, 0] > 435) == 2 * 610


@pytest.mark.parametrize(
    ("shape", "centre", "expected"),
    [
        pytest.param((330, 420), (170, 150), (170, 150), id="not reduced"),
        pytest.param((990, 1260), (150, 120), (270.4, 216.4), id="reduced from 1260 px to 700"),
        pytest.param((1260, 990), (120, 150), (216.4, 270.4), id="reduced, upright"),
    ],
)
def test_circles_of_a_disc(shape, centre, expected):
    """The centre is at a whole pixel of the reduced image, so it is found exactly."""
    scale = max(1.0, max(shape) / 700)
    image = discs(shape, (*expected, 61 * scale))
    best = circular_edges(cv2.GaussianBlur(image, (0, 0), 0.7 * scale))[0]
    assert best.centre_px == pytest.approx(expected, abs=0.01)
    assert best.radius_px == pytest.approx(61 * scale, abs=1.5 * scale)


@pytest.mark.parametrize(
    ("cut", "first"),
    [
        pytest.param(2, 50, id="91 % of the large circle"),
        pytest.param(10, 30, id="80 % of the large circle"),
    ],
)
def test_a_larger_circle_comes_first_if_it_is_covered_nearly_as_well(cut, first):
    """``cut`` is the width in pixels of the part of the large disc that is hidden."""
    image = discs((200, 300), (90, 100, 50.0), (220, 100, 30.0))
    image[100 + 50 - cut :, :160] = 0.2
    circles = circular_edges(cv2.GaussianBlur(image, (0, 0), 0.7))
    assert circles[0].radius_px == pytest.approx(first, abs=2)
    assert any(circle.radius_px == pytest.approx(80 - first, abs=2) for circle in circles)


@pytest.mark.parametrize(("radius", "found"), [(57.0, True), (75.0, False)])
def test_circles_have_up_to_0_6_of_the_shorter_side(radius, found):
    image = cv2.GaussianBlur(discs((100, 300), (150, 50, radius)), (0, 0), 0.7)
    sizes = [circle.radius_px for circle in circular_edges(image)]
    assert any(abs(size - radius) < 2 for size in sizes) == found


@pytest.mark.parametrize("shape", [(1, 3000), (3000, 1), (60, 60)])
def test_no_circles(shape):
    assert circular_edges(np.ones(shape, np.float32)) == []


def at(x, y=50.0, radius=30.0):
    return Ellipse((float(x), float(y)), (float(radius), float(radius)))


def test_circles_are_counted_by_size(monkeypatch):
    monkeypatch.setattr(
        edge_search, "circular_edges", lambda _: [at(9, 9, size) for size in (10, 20, 20, 40)]
    )
    values = np.zeros((1, 20, 20), np.float32)
    assert round_outlines(values) == 4
    assert round_outlines(values, [20.0]) == 2
    assert round_outlines(values, [20.0, 40.0]) == 3


def confirm_all(monkeypatch, candidates):
    """Let each circle have an outline, if there is one, whose highlights are those of a mirror."""
    examined = []

    def edge(_pictures, circle, _rivals):
        return candidates[circle]

    def has_highlights(_values, circle):
        examined.append(circle)
        return True

    monkeypatch.setattr(edge_search, "_refined", edge)
    monkeypatch.setattr(edge_search, "_has_highlights", has_highlights)
    monkeypatch.setattr(edge_search, "mirroring", lambda _values, sphere: sphere)
    return examined


def test_the_first_of_overlapping_candidates_is_the_sphere(monkeypatch):
    """Candidates that are no spheres, overlap, or get another size are skipped."""
    candidates = {
        at(400): image_of(400.0, 50.0),
        at(410): image_of(410.0, 50.0),
        at(300): None,
        at(305): image_of(305.0, 50.0),
        at(200): image_of(390.0, 50.0),  # its outline is that of the first
        at(100): image_of(100.0, 50.0, radius=36.0),
        at(90): image_of(90.0, 50.0),
        at(600): image_of(600.0, 50.0),
        at(20): image_of(20.0, 50.0),
        at(10, 200, 60): image_of(10.0, 200.0, radius=60.0),
    }
    monkeypatch.setattr(edge_search, "circular_edges", lambda _: list(candidates))
    confirm_all(monkeypatch, candidates)
    values = np.zeros((1, 20, 20), np.float32)
    monkeypatch.setattr(edge_search, "inside", lambda *_: True)
    known = [image_of(610.0, 50.0), image_of(-50.0, 50.0)]
    found = spheres_by_edges(values, [None], [30.0], known)
    assert sorted(sphere.outline.centre_px[0] for sphere in found) == [20, 90, 305, 400]
    found = spheres_by_edges(values, [None], (), ())
    assert sorted(s.outline.centre_px[0] for s in found) == [10, 20, 100, 305, 400, 600]


def test_a_sharp_outline_replaces_a_blurred_one(monkeypatch):
    """A blurred circle never replaces another one; only the first is checked for highlights."""
    first, blurred, sharp, after = at(400), at(404), at(408), at(412)
    candidates = {
        first: image_of(400.0, 50.0, scatter=0.8),
        blurred: image_of(404.0, 50.0, scatter=0.5),
        sharp: image_of(408.0, 50.0, scatter=0.1),
        after: image_of(412.0, 50.0, scatter=0.05),
    }
    examined = confirm_all(monkeypatch, candidates)
    monkeypatch.setattr(edge_search, "circular_edges", lambda _: list(candidates))
    monkeypatch.setattr(edge_search, "inside", lambda *_: True)
    found = spheres_by_edges(np.zeros((1, 20, 20), np.float32), [None], (), ())
    assert found == [candidates[sharp]]
    assert examined == [first]


@pytest.mark.parametrize(
    ("changes", "is_sphere"),
    [
        pytest.param({}, True, id="a sphere"),
        pytest.param({"lit": 8}, True, id="half of the lights"),
        pytest.param({"lit": 7}, False, id="fewer than half of the lights"),
        pytest.param({"lit_few": 4}, True, id="half of the first few lights"),
        pytest.param({"lit_few": 3}, False, id="fewer than half of the first few"),
        pytest.param({"coverage": 0.36}, True, id="a third is visible"),
        pytest.param({"coverage": 0.34}, False, id="less than a third is visible"),
        pytest.param({"radius": 114.0}, True, id="a little larger"),
        pytest.param({"radius": 86.0}, True, id="a little smaller"),
        pytest.param({"radius": 116.0}, False, id="much larger"),
        pytest.param({"radius": 84.0}, False, id="much smaller"),
        pytest.param({"moved": 2.1}, True, id="moves by more than 2 % of the radius"),
        pytest.param({"moved": 1.9}, False, id="moves by less than 2 % of the radius"),
        pytest.param({"radius": 30.0, "guess": 30.0, "moved": 1.1}, True, id="small, moves"),
        pytest.param({"radius": 30.0, "guess": 30.0, "moved": 0.9}, False, id="small, rests"),
        pytest.param({"lights": 1, "lit": 1, "lit_few": 1, "moved": 0.0}, True, id="one light"),
        pytest.param({"lights": 2, "lit": 2, "lit_few": 2, "moved": 0.0}, False, id="two rest"),
        pytest.param({"radius": 400.0, "guess": 400.0}, True, id="a large sphere"),
        pytest.param({"outline": False}, False, id="no outline"),
    ],
)
def test_a_candidate_is_a_sphere(monkeypatch, changes, is_sphere):
    options = {
        "lights": 16,
        "lit": 16,
        "lit_few": 8,
        "coverage": 0.9,
        "radius": 100.0,
        "guess": 100.0,
        "moved": 9.0,
        "outline": True,
    } | changes
    outline = at(50, 50, options["radius"])

    def highlights(values, circle):
        count = options["lit"] if circle is outline else options["lit_few"]
        assert len(values) == (
            options["lights"] if circle is outline else min(options["lights"], 8)
        )
        pixels = np.full((len(values), 2), np.nan)
        pixels[:count] = 40.0
        pixels[count - 1, 1] += options["moved"]
        return Highlights(pixels, np.zeros(len(values), bool), np.full(len(values), 0.05))

    def refine(_image, guess, reach_px, rivals):
        assert not rivals
        assert reach_px == pytest.approx(max(3.0, 0.03 * guess.radius_px))
        if not options["outline"]:
            raise EstimateError("no outline")
        return TracedOutline(outline, np.zeros((5, 2)), options["coverage"])

    monkeypatch.setattr(edge_search, "find_highlights", highlights)
    monkeypatch.setattr(edge_search, "refine_sharpest", refine)
    values = np.zeros((options["lights"], 20, 20), np.float32)
    guess = at(50, 50, options["guess"])
    edge = _refined(values[0], guess)
    sphere = mirroring(values, edge) if edge and _has_highlights(values, guess) else None
    assert (sphere is not None) == is_sphere
    if is_sphere:
        assert (sphere.outline, sphere.coverage) == (outline, options["coverage"])
        assert len(sphere.highlights.found) == options["lights"]


def searched(monkeypatch, images, camera=None, radii=None, others=()):
    """Search a stack in which these spheres are found, and the others next to them."""

    def find(values, radii_px=(), excluded=(), camera=None, reduced=None):
        return list(others) if excluded or (others and not radii_px and radii) else list(images)

    monkeypatch.setattr(search, "find_spheres", find)
    values = np.zeros((2, 30, 30), np.float32)
    return search.searched_spheres(values, camera, None if radii is None else np.array(radii))


def test_the_expected_size_is_that_of_a_sphere_on_the_working_plane(monkeypatch):
    """The centre is one radius above the plane: 1200 x 20 / (600 - 20); never in the camera."""
    asked = []

    def find_one(values, radii_px=(), excluded=(), camera=None, reduced=None):
        asked.append(list(radii_px))
        return [] if excluded else [image_of()]

    monkeypatch.setattr(search, "find_spheres", find_one)
    values = np.zeros((2, 30, 30), np.float32)
    search.searched_spheres(values, SMALL.camera, np.array([20.0, 30.0, 400.0]))
    assert asked == [pytest.approx([1200 * 20 / 580, 1200 * 30 / 570, 1200]), []]
    search.searched_spheres(values, SMALL.camera, None)
    assert asked[2:] == [[]]


def test_a_blurred_outline_around_a_sphere_of_another_size_is_not_named(monkeypatch):
    wanted, near, far = image_of(50.0), image_of(310.0, scatter=0.5), image_of(700.0, scatter=0.5)
    others = [image_of(300.0), image_of(500.0)]
    kept, notices = searched(monkeypatch, [wanted, near, far], SMALL.camera, [14.0], others)
    assert kept == [wanted]
    assert [notice.code for notice in notices] == ["sphere-of-another-size", "sphere-blurred"]
    assert "the spheres at (300, 20), (500, 20) px were left out" in notices[0].text
    assert "outlines there fit about 14.6, 14.6 mm" in notices[0].text
    assert "the sphere at (700, 20) px" in notices[1].text


@pytest.mark.parametrize(
    ("scatters", "left"),
    [
        pytest.param((0.01, 0.16), (), id="all sharp enough"),
        pytest.param((0.01, 0.175), (1,), id="over a quarter of a pixel"),
        pytest.param((0.1, 0.29), (), id="less than three times the sharpest"),
        pytest.param((0.1, 0.31, 0.2), (1,), id="more than three times the sharpest"),
    ],
)
def test_outlines_that_scatter_are_left_out(monkeypatch, scatters, left):
    images = [image_of(100.0 * k, scatter=s) for k, s in enumerate(scatters)]
    kept, warnings = searched(monkeypatch, images)
    assert kept == [image for k, image in enumerate(images) if k not in left]
    assert len(warnings) == len(left)
    for notice, k in zip(warnings, left, strict=True):
        assert notice.code == "sphere-blurred"
        assert f"({100 * k}, 20) px was left out: the outline scatters by" in notice.text


def test_spheres_of_another_size_are_reported_with_their_size(monkeypatch):
    """30 px at 600 mm and 1200 px focal length: 600 x 30 / 1230 = 14.6 mm on the plane."""
    wanted, other = image_of(100.0, radius=40.0), image_of(300.0)
    kept, warnings = searched(monkeypatch, [wanted], SMALL.camera, [20.0], [other])
    assert kept == [wanted]
    (notice,) = warnings
    text = "(300, 20) px was left out: the sharp outline there fits about 14.6 mm, not 20"
    assert text in notice.text
    with pytest.raises(EstimateError, match=r"no sphere of 20 mm found, but .* about 14\.6 mm"):
        searched(monkeypatch, [], SMALL.camera, [20.0], [other])
    with pytest.raises(EstimateError, match="no mirror sphere found: 0 round outlines"):
        searched(monkeypatch, [], SMALL.camera, [20.0])
    with pytest.raises(EstimateError, match="no mirror sphere found: 0 round outlines"):
        searched(monkeypatch, [])
    monkeypatch.setattr(search, "round_outlines", lambda *_: 1)
    with pytest.raises(EstimateError, match="no mirror sphere found: 1 round outline in the mean"):
        searched(monkeypatch, [])


@cases(
    ("radius_mm", "text"),
    {
        "any size": (
            None,
            "show no outline of a mirror sphere around them: light the background evenly, or give "
            "masks or circles",
        ),
        "one size": (
            20.0,
            "a mirror sphere with a radius near 41 px around them: light the background evenly, or "
            "check the radius, or give masks or circles",
        ),
    },
)
def test_lights_without_an_outline_are_named(monkeypatch, radius_mm, text):
    """The outline is what is missing, not the highlights."""
    monkeypatch.setattr(search, "find_spheres", lambda values, *args, **kwargs: [])
    values = np.full((5, 120, 160), 0.1, np.float32)
    for k in range(5):
        cv2.circle(values[k], (60 + 6 * k, 50 + 7 * (k % 3)), 3, (1.0,), -1)
    radii, camera = (None, None) if radius_mm is None else (np.array([radius_mm]), SMALL.camera)
    with pytest.raises(EstimateError, match="bright spots move with the light near") as refusal:
        search.searched_spheres(values, camera, radii)
    assert text in str(refusal.value)


def test_images_of_noise_have_no_more_clusters_than_a_search_can_try():
    """The lights were off: thousands of places look like highlights, and each is tried."""
    noise = np.random.default_rng(0).normal(0, 0.002, (6, 200, 260)).clip(0).astype(np.float32)
    lit = noise.copy()
    for k in range(6):
        lit[k, 98:101, 100 + 8 * k : 103 + 8 * k] = 0.8
    assert len(spot_clusters(reduce_stack(noise))) == 32
    assert spot_clusters(reduce_stack(lit))[0].centre_px == pytest.approx((121, 99), abs=5)
