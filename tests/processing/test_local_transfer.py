from __future__ import annotations

from functools import partial

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import DataError, angle_deg
from processing import NormalMap, ShapeFilter, read_normals, separate, transfer_local
from processing.detail import Pose, Similarity
from processing.detail.seam import _membrane, blend_detail, seam_of, seam_steps
from rig.arrays import Bool, Float64
from tests.cases import cases
from tests.processing import scenes
from tests.processing.scenes import ball
from tests.quick_sample import quick
from tests.real_data import DATA, needs_data

relief = partial(scenes.relief, blur_px=1.5)


def ellipse(size: tuple[int, int], x: float, y: float, a: float, b: float) -> Bool:
    rows, columns = np.mgrid[: size[0], : size[1]]
    return np.asarray(((columns - x) / a) ** 2 + ((rows - y) / b) ** 2 <= 1)


def test_a_quarter_turn_rotates_pixels_and_normals() -> None:
    given_map = relief(0, (31, 31))
    place = Similarity((15, 15), (15, 15), rotate_deg=90)
    placed = place.place(given_map, (31, 31))
    assert placed is not None
    x, y, z = np.moveaxis(np.rot90(given_map.normals), 2, 0)
    expected = np.stack([-y, x, z], axis=2)
    assert placed.mask.all()
    off = angle_deg(placed.normals, expected)[placed.mask]
    assert off.max() < 1e-4


def test_a_mirror_exchanges_left_and_right_of_pixels_and_normals() -> None:
    given_map = relief(1, (21, 31))
    placed = Similarity((15, 10), (15, 10), mirror=True).place(given_map, (21, 31))
    assert placed is not None
    expected = given_map.normals[:, ::-1] * [-1, 1, 1]
    assert angle_deg(placed.normals, expected)[placed.mask].max() < 1e-4


@pytest.mark.parametrize("shrink", [1, 2, 3, 5])
@pytest.mark.parametrize("wavelength_px", [9.0, 14.0, 40.0])
def test_shrinking_blurs_like_wider_pixels(shrink: int, wavelength_px: float) -> None:
    """A Gaussian pixel of sigma 0.5 remains one: a wave is reduced by exp(-k^2 (s^2 - 1) / 8).

    Every pixel of the small map is a whole pixel of the large map, where interpolation is exact.
    """
    size, slope, k = 240, 1e-3, 2 * np.pi / wavelength_px
    columns = np.arange(size, dtype=float)
    wave = np.broadcast_to(slope * np.cos(k * (columns - 120)), (size, size))
    vectors = np.stack([wave, np.zeros_like(wave), np.ones_like(wave)], axis=2)
    place = Similarity((120, 120), (120, 120), 1 / shrink)
    placed = place.place(NormalMap.from_vectors(vectors), (size, size))
    assert placed is not None
    assert placed.mask[120, 120]
    slope_after = placed.normals[120, 120, 0] / placed.normals[120, 120, 2]
    expected = slope * np.exp(-(k**2) * (shrink**2 - 1) / 8)
    # cv2 truncates its kernel at about four sigma, rounded to whole pixels.
    assert slope_after == pytest.approx(expected, abs=0.01 * slope)


@settings(max_examples=40)
@given(
    st.floats(-360, 360),
    st.floats(0.4, 3),
    st.booleans(),
    st.tuples(st.floats(40, 60), st.floats(40, 60)),
)
def test_placed_normals_are_those_of_the_placed_surface(
    rotate_deg: float, scale: float, mirror: bool, at: tuple[float, float]
) -> None:
    """The placed normals of a smooth height field equal those computed from its slopes."""

    def normals(x: Float64, y: Float64) -> NormalMap:
        # The gradient of 3 cos(x / 12) + 2 sin(y / 9), with y upwards instead of rows downwards.
        dx, dy = -np.sin(x / 12) / 4, 2 * np.cos(y / 9) / 9
        return NormalMap.from_vectors(np.stack([-dx, dy, np.ones_like(x)], axis=2))

    rows, columns = np.mgrid[:90, :100].astype(float)
    placed = Similarity((50, 45), at, scale, rotate_deg, mirror).place(
        normals(columns, rows), (100, 100)
    )
    assert placed is not None
    angle = np.radians(rotate_deg)
    rows, columns = np.mgrid[:100, :100].astype(float)
    right, up = (columns - at[0]) / scale, -(rows - at[1]) / scale
    x = np.cos(angle) * right + np.sin(angle) * up
    y = -np.sin(angle) * right + np.cos(angle) * up
    side = -1 if mirror else 1
    seen = normals(50 + side * x, 45 - y).normals.astype(float)
    nx, ny = side * seen[..., 0], seen[..., 1]
    expected = np.stack(
        [
            np.cos(angle) * nx - np.sin(angle) * ny,
            np.sin(angle) * nx + np.cos(angle) * ny,
            seen[..., 2],
        ],
        axis=2,
    )
    off = angle_deg(placed.normals, expected)[placed.mask]
    # The low-pass filter before shrinking reduces the slopes slightly, mostly at the rim.
    assert np.mean(off) < (0.05 if scale >= 1 else 0.2)
    assert off.max() < (0.1 if scale >= 1 else 2.5)


@pytest.mark.parametrize("reach", [0.5, 3.0, 25.0])
def test_the_membrane_solves_its_equation_and_keeps_the_seam(reach: float) -> None:
    rng = np.random.default_rng(0)
    region = np.zeros((50, 60), bool)
    region[5:45, 8:50] = rng.random((40, 42)) < 0.9
    target = np.ones_like(region)
    target[:, 40:] = False
    target |= region
    seam = seam_of(region, target)
    step = np.where(seam[..., None], rng.normal(size=(50, 60, 2)), 0)
    u = _membrane(step, seam, region, reach)
    np.testing.assert_array_equal(u[seam], step[seam])
    assert not u[~region].any()
    for r, c in np.argwhere(region & ~seam):
        near = [(r + 1, c), (r - 1, c), (r, c + 1), (r, c - 1)]
        pull = sum(u[q] - u[r, c] for q in near if region[q])
        np.testing.assert_allclose(pull, u[r, c] / reach**2, atol=1e-4)


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 30), st.floats(0, 1))
def test_blending_keeps_unit_length_for_any_details(seed: int, reach: float, full: float) -> None:
    rng = np.random.default_rng(seed)
    inner, outer = (NormalMap.from_vectors(rng.normal(size=(9, 11, 3))) for _ in range(2))
    inner.normals[4, 5] = (0, 0, -1)
    region = rng.random((9, 11)) < full
    if not region.any():
        region[4, 5] = True
    blended = blend_detail(inner, outer, region, reach)
    np.testing.assert_allclose(np.linalg.norm(blended, axis=2), 1, atol=1e-6)
    kept = ~region | seam_of(region, outer.mask)
    np.testing.assert_array_equal(blended[kept], outer.normals[kept])


def test_blending_a_detail_into_itself_changes_nothing_poles_included() -> None:
    vectors = np.random.default_rng(0).normal(size=(12, 12, 3))
    vectors[3:9, 3:6] = (0, 0, -1)
    vectors[3:9, 6:9] = (0, 0, 1)
    detail = NormalMap.from_vectors(vectors)
    region = np.zeros((12, 12), bool)
    region[2:10, 2:10] = True
    blended = blend_detail(detail, detail, region, 4.0)
    assert angle_deg(blended, detail.normals).max() < 1e-4


def test_a_part_that_covers_the_target_has_no_seam() -> None:
    target = ball(60)
    result = transfer_local(
        relief(6, (100, 100)), target, pose=Pose((30, 30)), shape_filter=ShapeFilter(w=4)
    )
    np.testing.assert_array_equal(result.region, target.mask)
    assert np.isnan(result.seam.ratio)
    assert np.isfinite(result.fidelity.detail_mae_deg)


def test_a_flat_part_has_no_ratio() -> None:
    flat = NormalMap.from_vectors(np.broadcast_to((0.0, 0.0, 1.0), (40, 40, 3)))
    region = ellipse((40, 40), 20, 20, 9, 9)
    assert np.isnan(seam_steps(flat, region).ratio)


def test_the_seam_step_of_a_fold() -> None:
    """Two planes at 10 degrees meet at the seam; inside, the normal changes by 1 degree a pixel."""
    turn = np.zeros((20, 40))
    turn[:, 20:] = np.radians(10 + np.arange(20))
    folded = NormalMap.from_vectors(np.stack([np.sin(turn), 0 * turn, np.cos(turn)], axis=2))
    region = np.zeros((20, 40), bool)
    region[:, 20:] = True
    steps = seam_steps(folded, region)
    assert steps.seam_deg == pytest.approx(10, abs=1e-4)
    # 1 degree for each of 18 x 20 horizontal pairs, 0 for each of 19 x 19 vertical pairs.
    assert steps.interior_deg == pytest.approx(360 / (360 + 361), abs=1e-4)


def test_a_part_is_complete_and_the_rest_does_not_change() -> None:
    source, target = relief(2, (90, 90)), ball()
    mask = ellipse((90, 90), 45, 45, 36, 30)
    result = transfer_local(
        source,
        target,
        source_mask=mask,
        pose=Pose((60, 62)),
        shape_filter=ShapeFilter(w=5),
        reach_px=3.0,
    )
    expected = np.zeros(target.size, bool)
    expected[17:107, 15:105] = mask
    expected &= target.mask
    np.testing.assert_array_equal(result.region, expected)
    got = result.normal_map.normals
    np.testing.assert_array_equal(got[~expected], target.normals[~expected])
    np.testing.assert_array_equal(result.normal_map.mask, target.mask)
    # Far from the seam the detail is the source's, on the shape of the target.
    deep = cv2.erode(expected.astype(np.uint8), np.ones((35, 35), np.uint8)) > 0
    assert deep.sum() > 50
    shape = separate(target, shape_filter=ShapeFilter(w=5)).shape.normals
    detail = separate(source, shape_filter=ShapeFilter(w=5)).detail.normals
    there = np.argwhere(deep)
    for r, c in there[::7]:
        along = got[r, c] @ shape[r, c]
        assert along == pytest.approx(detail[r - 17, c - 15, 2], abs=2e-3)


def test_a_part_inserted_at_its_own_position_changes_nothing() -> None:
    original = ball()
    mask = ellipse(original.size, 60, 60, 30, 20)
    result = transfer_local(original, original, source_mask=mask)
    assert result.region.sum() == mask.sum()
    off = angle_deg(result.normal_map.normals, original.normals)[original.mask]
    assert off.max() < 1e-4
    assert result.fidelity.detail_mae_deg < 1e-4


def test_a_target_mask_limits_and_positions_the_part() -> None:
    source, target = relief(3, (60, 60)), ball()
    room = ellipse(target.size, 50, 70, 15, 12)
    result = transfer_local(source, target, target_mask=room, shape_filter=ShapeFilter(w=4))
    np.testing.assert_array_equal(result.region, room)
    assert result.placement.at == (50, 70)


def test_the_membrane_removes_the_step() -> None:
    source, target = relief(4, (80, 80), slope=6.0), ball(160)
    options = {"pose": Pose((80, 80)), "source_mask": ellipse((80, 80), 40, 40, 30, 30)}
    pasted = transfer_local(source, target, reach_px=1e-3, **options)  # type: ignore[arg-type]
    set_in = transfer_local(source, target, **options)  # type: ignore[arg-type]
    assert pasted.seam.seam_deg > 1.5 * set_in.seam.seam_deg
    assert set_in.seam.ratio < 1


@cases(
    ("options", "text"),
    {
        "sizes without a position": ({}, "has no position on a target"),
        "outside": ({"pose": Pose((500, 5))}, "does not overlap the target mask"),
        "on the empty corner": ({"pose": Pose((0, 0), scale=0.1)}, "does not overlap"),
        "no scale": ({"pose": Pose((60, 60), scale=0.0)}, "scale of 0.0"),
        "no angle": ({"pose": Pose((60, 60), rotate_deg=np.nan)}, "turn of nan"),
        "infinitely far": ({"pose": Pose((np.inf, 60))}, "place of"),
        "amplitude": ({"pose": Pose((60, 60)), "amplitude": np.inf}, "amplitude of inf"),
        "reach": ({"pose": Pose((60, 60)), "reach_px": 0.0}, "reach of 0.0 px"),
        "w too large": (
            {"pose": Pose((60, 60)), "shape_filter": ShapeFilter(w=60)},
            "larger than the normal map",
        ),
        "mask size": ({"source_mask": np.ones((3, 3), bool)}, "source_mask must be bool of shape"),
        "empty": ({"target_mask": np.zeros((120, 120), bool)}, "target's normals do not"),
    },
)
def test_local_transfer_refuses(options: dict[str, object], text: str) -> None:
    with pytest.raises(DataError, match=text):
        transfer_local(relief(5, (40, 40)), ball(), **options)  # type: ignore[arg-type]


@needs_data
@pytest.mark.parametrize(
    ("source", "target", "part", "pose"),
    quick(
        [
            pytest.param(
                "cat",
                "bear",
                (390, 166, 45, 35),
                Pose((303, 188), scale=1.2, rotate_deg=6.0),
                id="cat's face onto bear",
            ),
            pytest.param(
                "buddha",
                "bear",
                (305, 118, 27, 34),
                Pose((303, 185), scale=1.5, mirror=True),
                id="buddha's face onto bear",
            ),
        ],
        every=2,
    ),
)
def test_real_faces_show_no_seam(
    source: str, target: str, part: tuple[int, int, int, int], pose: Pose
) -> None:
    folder = DATA / "normals" / "diligent"
    first, second = (read_normals(folder / name).normal_map for name in (source, target))
    mask = ellipse(first.size, *part)
    result = transfer_local(first, second, source_mask=mask, pose=pose)
    assert result.seam.ratio <= 1.2
    pasted = transfer_local(first, second, source_mask=mask, pose=pose, reach_px=1e-2)
    assert pasted.seam.seam_deg > 1.5 * result.seam.seam_deg
    assert result.fidelity.detail_mae_deg < 5
    assert result.region.sum() > 5000
