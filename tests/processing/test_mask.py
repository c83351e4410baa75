import numpy as np
import pytest
from scipy import ndimage

from acquisition import DataError, read_image
from calibration import EstimateError
from processing.maps import object_mask
from tests.real_data import DATA, needs_data


def _directions(count=12):
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(count, 3))
    directions[:, 2] = np.abs(directions[:, 2] + 2)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _ball(size=160, radius=50.0, centre=(80, 70)):
    x, y = np.meshgrid(np.arange(size) - centre[0], np.arange(size) - centre[1])
    z = np.sqrt(np.clip(radius**2 - x * x - y * y, 0, None)) / radius
    return np.stack([x / radius, -y / radius, z], axis=2), z > 0


def _recorded(normals, mask, *, background=0.01, noise=0.002, seed=0):
    shading = np.clip(np.einsum("ni,hwi->nhw", _directions(), normals), 0, None)
    values = np.where(mask, 0.6 * shading, background)
    return values + np.random.default_rng(seed).normal(0, noise, values.shape)


def _iou(a, b):
    return np.count_nonzero(a & b) / np.count_nonzero(a | b)


def test_a_ball_in_front_of_a_dark_background():
    normals, truth = _ball()
    result = object_mask(_recorded(normals, truth))
    assert _iou(result.mask, truth) > 0.98
    assert result.contrast > 10


def test_saturation_counts_as_bright_and_dead_pixels_do_not():
    normals, truth = _ball()
    values = _recorded(normals, truth)
    values[3, 60:75, 75:90] = np.nan
    values[:, 65:68, 60:70] = np.inf
    values[:, 55:85, 110:131] = np.nan
    values[:, 5, 7] = np.nan
    values[4, 150, 20] = 5.0
    result = object_mask(values)
    assert _iou(result.mask, truth) > 0.97
    assert (result.mask | ~truth)[55:85].all()
    assert not result.mask[5, 7]
    assert not result.mask[150, 20]
    assert result.mask[60:75, 75:90].all()


def test_holes_are_filled_and_dust_is_dropped_but_parts_are_kept():
    normals, truth = _ball(radius=40.0)
    values = _recorded(normals, truth)
    values[:, 60:64, 78:84] = 0.01
    values[:, 2:6, 150:155] = 0.5
    values[:, 140:155, 20:60] = 0.5
    mask = object_mask(values).mask
    expected = truth.copy()
    expected[140:155, 20:60] = True
    assert _iou(mask, expected) > 0.97
    assert not mask[2:6, 150:155].any()


def test_what_is_outside_is_not_examined():
    """A bright card next to a dark object would be taken for the object."""
    normals, truth = _ball(radius=40.0)
    values = 0.04 * _recorded(normals, truth, noise=0.0005)
    card = np.zeros(truth.shape, bool)
    card[:, 130:] = True
    values[:, card] = 0.8
    assert not object_mask(values).mask[truth].any()
    mask = object_mask(values, outside=card).mask
    assert _iou(mask, truth) > 0.97
    assert not mask[card].any()


@pytest.mark.parametrize(
    "outside",
    [np.ones((160, 160), bool), np.zeros((5, 5), bool), np.zeros((160, 160), np.uint8)],
    ids=["everything", "size", "type"],
)
def test_a_wrong_outside_is_refused(outside):
    with pytest.raises(DataError, match="outside must be bool"):
        object_mask(_recorded(*_ball()), outside=outside)


def _relief(texture):
    rng = np.random.default_rng(8)
    z = ndimage.gaussian_filter(rng.normal(size=(120, 120)), 3)
    gy, gx = np.gradient(z / z.std())
    normals = np.stack([-gx, gy, np.ones_like(z)], axis=2)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    paint = np.exp(texture * ndimage.gaussian_filter(rng.normal(size=(120, 120)), 2))
    return _recorded(normals, np.ones((120, 120), bool)) * paint


NOISE = np.random.default_rng(0).normal(0.01, 0.003, (9, 80, 80))
HIDDEN = {
    "relief fills frame": (_relief(0.0), "no object stands out"),
    "textured relief fills frame": (_relief(4.0), "no object stands out"),
    "contrast without groups": (_relief(8.0), "contrast [345].*separability 0.[67]"),
    "noise": (NOISE, "stands out"),
    "even": (np.full((4, 30, 30), 0.5), "no object stands out"),
    "black": (np.zeros((4, 30, 30)), "all images are black"),
    "negative": (np.full((4, 30, 30), -0.1), "all images are black"),
    "saturated": (np.full((4, 30, 30), np.nan), "black or saturated"),
    "bright background": (_recorded(*_ball(), background=0.4), "no object stands out"),
}


@pytest.mark.parametrize("name", HIDDEN)
def test_images_without_a_visible_object_are_refused(name):
    values, message = HIDDEN[name]
    with pytest.raises(EstimateError, match=message):
        object_mask(values)


@pytest.mark.parametrize("shape", [(5, 6), (3, 4, 5, 3), (0, 4, 5)], ids=str)
def test_an_array_that_is_not_a_stack_is_refused(shape):
    with pytest.raises(DataError, match="stack"):
        object_mask(np.ones(shape))


@needs_data
@pytest.mark.parametrize(
    ("folder", "images", "mask"),
    [
        pytest.param("diligent/bearPNG", "[0-9]*.png", "mask.png", id="bear"),
        pytest.param("diligent/catPNG", "[0-9]*.png", "mask.png", id="cat"),
        pytest.param("uw/buddha", "buddha.[0-9]*.tga", "buddha.mask.tga", id="uw-buddha"),
        pytest.param("uw/cat", "cat.[0-9]*.tga", "cat.mask.tga", id="uw-cat"),
        pytest.param("uw/gray", "gray.[0-9]*.tga", "gray.mask.tga", id="uw-gray"),
    ],
)
def test_real_objects_are_found(folder, images, mask):
    folder = DATA / folder
    files = sorted(folder.glob(images))
    strength = np.ones((len(files), 3))
    if (folder / "light_intensities.txt").exists():
        strength = np.loadtxt(folder / "light_intensities.txt")
    # Twelve lights from all directions: the first twelve of DiLiGenT are all on one side.
    picked = np.random.default_rng(7).permutation(len(files))[:12]
    values = [(read_image(files[i]) / strength[i]).mean(axis=2).astype(np.float32) for i in picked]
    truth = read_image(folder / mask)
    truth = (truth if truth.ndim == 2 else truth[..., 0]) > 127
    assert _iou(object_mask(np.stack(values)).mask, truth) >= 0.975
