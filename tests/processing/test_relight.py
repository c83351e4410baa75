"""Relightable images: closed forms, a matte ball, recordings, files of other programs' form."""

import json

import cv2
import numpy as np
import pytest

from acquisition import (
    CameraModel,
    DataError,
    Lights,
    MissingPathError,
    read_source,
    write_exr,
    write_png,
)
from calibration import EstimateError
from processing import NormalMap
from processing.relight import (
    RelightableImage,
    fit_normals,
    fit_recording,
    light_basis,
    read_ptm,
    write_ptm,
    write_rti_planes,
)
from processing.relight.ptm_bytes import ptm_bytes
from processing.relight.relightable_fit import PENALTY, fitted

ABOVE, BELOW, RIGHT = (0, 1, 0.6), (0, -1, 0.6), (1, 0, 0.6)


@pytest.fixture(scope="module")
def ball():
    """A matte ball without a background, and its mask."""
    y, x = np.mgrid[1:-1:48j, -1:1:48j]
    mask = x**2 + y**2 < 0.9
    z = np.sqrt(np.clip(1 - x**2 - y**2, 0, 1))
    return NormalMap.from_vectors(np.dstack([x, y, z]), mask)


@pytest.fixture(scope="module")
def fits(ball):
    """Fits of the ball, reddish, by basis and colours."""
    albedo = np.where(ball.mask[..., None], [0.6, 0.4, 0.2], 0)
    return {
        (basis, colours): fit_normals(ball, albedo, basis=basis, colours=colours)
        for basis in ("ptm", "hsh4", "hsh9")
        for colours in ("lrgb", "rgb")
    }


def hemisphere(count: int, seed: int = 0) -> np.ndarray:
    """Return random directions, uniform over the hemisphere."""
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    vectors[:, 2] = np.abs(vectors[:, 2]) + 1e-3
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_harmonics_are_orthonormal_over_the_hemisphere():
    """Gauss-Legendre in the cosine and equal steps around: exact for these functions but sqrt."""
    nodes, weights = np.polynomial.legendre.leggauss(400)
    w, area = (nodes + 1) / 2, weights / 2
    around = np.arange(16) * np.pi / 8
    side = np.sqrt(1 - w**2)
    grid = np.stack(np.broadcast_arrays(
        side[:, None] * np.cos(around), side[:, None] * np.sin(around), w[:, None]
    ), axis=-1)  # fmt: skip
    values = light_basis(grid, "hsh9")
    products = np.einsum("wak,wal,w->kl", values, values, area) * np.pi / 8
    np.testing.assert_allclose(products, np.eye(9), atol=1e-6)


def test_harmonics_are_those_of_the_viewers():
    """The formulas in polar angles, as the viewers write them."""
    vectors = hemisphere(20)
    cos, phi = vectors[:, 2], np.arctan2(vectors[:, 1], vectors[:, 0])
    root, flat = np.sqrt(cos - cos**2), cos**2 - cos
    expected = [
        np.full(20, 1 / np.sqrt(2 * np.pi)),
        np.sqrt(6 / np.pi) * np.cos(phi) * root,
        np.sqrt(3 / (2 * np.pi)) * (2 * cos - 1),
        np.sqrt(6 / np.pi) * root * np.sin(phi),
        np.sqrt(30 / np.pi) * np.cos(2 * phi) * flat,
        np.sqrt(30 / np.pi) * np.cos(phi) * (2 * cos - 1) * root,
        np.sqrt(5 / (2 * np.pi)) * (1 - 6 * cos + 6 * cos**2),
        np.sqrt(30 / np.pi) * (2 * cos - 1) * root * np.sin(phi),
        np.sqrt(30 / np.pi) * flat * np.sin(2 * phi),
    ]
    np.testing.assert_allclose(light_basis(vectors, "hsh9"), np.stack(expected, -1), atol=1e-12)
    np.testing.assert_array_equal(light_basis(vectors, "hsh4"), light_basis(vectors, "hsh9")[:, :4])


@pytest.mark.parametrize("shared", [True, False], ids=["distant", "near"])
def test_the_fit_is_least_squares_with_gaps(shared):
    """Against numpy's least squares with the penalty as further equations."""
    random = np.random.default_rng(3)
    values = random.normal(size=(20, 7)).astype(np.float32)
    values[random.random(values.shape) < 0.3] = np.nan
    values[:, 5], values[3:, 6], values[:, 0] = np.nan, np.inf, 0.25
    weights = light_basis(hemisphere(20 if shared else 140), "ptm").reshape(-1, 20, 6)
    found = fitted(values, weights)
    for pixel in range(7):
        known = np.isfinite(values[:, pixel])
        rows = weights[0 if shared else pixel][known]
        size = np.sqrt(PENALTY * known.sum()) * np.eye(6)
        right = np.concatenate([values[known, pixel], np.zeros(6)])
        expected = np.linalg.lstsq(np.concatenate([rows, size]), right, rcond=None)[0]
        np.testing.assert_allclose(found[pixel], expected, rtol=1e-3, atol=1e-5)
    assert not found[5].any()


def test_a_matte_ball_looks_as_its_shading(ball, fits):
    """With linear values, a fit is as far from the shading as its residual says."""
    found = fit_normals(ball, np.where(ball.mask, 0.5, 0), basis="hsh9", values="linear")
    assert found.white == pytest.approx(0.5, rel=0.01)
    left = []
    lights = hemisphere(80, 1)
    for light in lights[lights[:, 2] > 0.1]:
        shading = np.maximum(ball.normals @ light, 0) * 0.5 / found.white
        left.append(found.image.relit(light)[..., 0] - shading)
    rms = float(np.sqrt(np.mean(np.square(left)[:, ball.mask])))
    stated = float(np.sqrt(np.mean(found.residual[ball.mask] ** 2)))
    assert rms == pytest.approx(stated, rel=0.2)
    assert stated < 0.05
    assert not found.image.relit(ABOVE)[~ball.mask].any()
    order = [np.median(fits[b, "rgb"].residual[ball.mask]) for b in ("hsh4", "ptm", "hsh9")]
    assert order == sorted(order, reverse=True)


def centre_of_light(picture: np.ndarray) -> tuple[float, float]:
    """Return where a picture is bright: x to the right and y up, relative to its middle."""
    shown = np.clip(picture[..., 0], 0, 1)
    y, x = np.mgrid[1 : -1 : shown.shape[0] * 1j, -1 : 1 : shown.shape[1] * 1j]
    return float((x * shown).sum() / shown.sum()), float((y * shown).sum() / shown.sum())


def stored_images(image, folder):
    """Yield the image, and what its files hold."""
    yield image
    yield write_rti_planes(folder, image, hemisphere(9))[1]
    if image.basis == "ptm":
        write_ptm(folder / "ball.ptm", image)
        yield read_ptm(folder / "ball.ptm")


def test_up_is_up_and_right_is_right_in_every_file(fits, tmp_path):
    for fit in fits.values():
        for image in stored_images(fit.image, tmp_path):
            for light in (ABOVE, BELOW, RIGHT):
                x, y = centre_of_light(image.relit(light))
                assert np.sign(np.round([x, y], 1)).tolist() == list(light[:2]), (image, light)


def test_a_file_relights_as_its_fit(ball, fits, tmp_path):
    for colours, most in (("lrgb", 1.0), ("rgb", 2.3)):
        image = fits["ptm", colours].image
        stored = write_ptm(tmp_path / "a.ptm", image)
        read = read_ptm(tmp_path / "a.ptm")
        assert repr(read) == f"RelightableImage(ptm, {colours.upper()}, 48 x 48 px)"
        left = []
        for light in hemisphere(40, 2):
            np.testing.assert_allclose(read.relit(light), stored.relit(light), atol=2e-6)
            left.append(255 * (read.relit(light) - image.relit(light))[ball.mask])
        assert np.sqrt(np.mean(np.square(left))) < 0.6
        assert np.abs(left).max() < most
        header = (tmp_path / "a.ptm").read_bytes().split(b"\n", 4)[:4]
        assert header == [b"PTM_1.2", f"PTM_FORMAT_{colours.upper()}".encode(), b"48", b"48"]


def test_planes_are_what_viewers_decode(fits, tmp_path):
    """The formula of the viewers, written again here, from the files."""
    for (basis, colours), fit in fits.items():
        files, stored = write_rti_planes(tmp_path, fit.image, [[0, 3, 4]], quality=90)
        info = json.loads(files[-1].read_text())
        assert info["type"] == basis[:3]
        assert (info["colorspace"], info["width"], info["height"]) == (colours, 48, 48)
        assert info["lights"] == [0, 0.6, 0.8]
        count = info["nplanes"] // 3
        assert [path.name for path in files[:-1]] == [f"plane_{i}.jpg" for i in range(count)]
        material = info["materials"][0]
        assert len(material["scale"]) == len(material["bias"]) == info["nplanes"]
        planes = np.concatenate([cv2.imread(str(f))[..., ::-1] for f in files[:-1]], axis=2) / 255
        planes = (planes - material["bias"]) * material["scale"]
        weights = light_basis(RIGHT, basis)
        if colours == "lrgb":
            found = (planes[..., 3 : 3 + len(weights)] @ weights)[..., None] * planes[..., :3]
        else:
            found = np.einsum("hwkc,k->hwc", planes.reshape(48, 48, -1, 3), weights)
        np.testing.assert_allclose(found, stored.relit(RIGHT), atol=1e-4)


def write_images(folder, lights, points, albedo, normals):
    """Write linear images of a matte surface under lights."""
    folder.mkdir(exist_ok=True)
    for i in range(len(lights)):
        vectors = lights.take([i]).vectors_at(points.reshape(-1, 3)).reshape(*points.shape)
        shade = np.maximum(np.sum(vectors * normals, axis=-1), 0)
        write_exr(folder / f"a.{i:02d}.exr", (shade[..., None] * albedo).astype(np.float32))


def test_near_lights_become_distant_ones(tmp_path):
    """A white card under lamps at 150 mm: evenly bright, as under the sun."""
    camera = CameraModel([[300, 0, 19.5], [0, 300, 15.5], [0, 0, 1]], 40, 32, 300.0)
    points = camera.points_at(np.full((32, 40), 300.0))
    positions = 150 * hemisphere(24, 5)
    positions[:, 2] = np.maximum(positions[:, 2], 60)
    lights = Lights(positions_mm=positions)
    write_images(tmp_path / "card", lights, points, np.ones(3), np.array([0, 0, 1.0]))
    source = read_source(tmp_path / "card", lights=lights, camera=camera)
    spread = {}
    for distant in (False, True):
        found = fit_recording(source, values="linear", distant=distant)
        seen = found.image.relit([0.3, 0.2, 1])[..., 1]
        spread[distant] = float(np.ptp(seen) / seen.mean())
    assert spread[False] < 0.06 < 0.12 < spread[True]
    depth = np.full((32, 40), np.nan)
    depth[4:20] = 300
    with_map = fit_recording(source, values="linear", depth_mm=depth)
    without = fit_recording(source, values="linear")
    np.testing.assert_array_equal(with_map.image.coefficients, without.image.coefficients)
    with pytest.raises(DataError, match="a depth of shape"):
        fit_recording(source, depth_mm=depth[:-1])


def test_a_recording_in_colour_with_saturation(ball, tmp_path):
    """Saturated samples do not count; a pixel that is always saturated is black and counted."""
    directions = hemisphere(16, 7)
    directions[:, 2] += 0.5
    lights = Lights(directions=directions)
    shade = np.maximum(np.einsum("hwc,nc->nhw", ball.normals, lights.unit_directions), 0)
    samples = np.rint(shade[..., None] * [60_000, 40_000, 20_000]).astype(np.uint16)

    def fit(name, **options):
        (tmp_path / name).mkdir()
        for i, image in enumerate(samples):
            write_png(tmp_path / name / f"a.{i:02d}.png", image)
        return fit_recording(read_source(tmp_path / name, lights=lights), **options)

    whole = fit("whole", colours="rgb")
    # White is the brightest red, apart from the .1 % that are brighter.
    assert whole.white == pytest.approx(60_000 / 65_535, rel=0.02)
    assert whole.without_samples == 0
    shown = whole.image.relit(ABOVE)[12, 24]
    assert shown[0] > shown[1] > shown[2] > 0
    samples[:3, 10:14] = 65_535
    samples[:, 30:34, 20:25] = 65_535
    some = fit("some", colours="rgb")
    assert some.without_samples == 20
    assert np.isnan(some.residual[30:34, 20:25]).all()
    assert not some.image.relit(ABOVE)[30:34, 20:25].any()
    np.testing.assert_allclose(some.image.relit(ABOVE)[12, 24], shown, atol=0.1)
    lrgb = fit("lrgb")
    np.testing.assert_allclose(
        lrgb.image.relit(ABOVE)[12, 24], some.image.relit(ABOVE)[12, 24], atol=0.02
    )


OTHER = RelightableImage("hsh4", np.zeros((4, 4, 4, 3), "f4"))
WRONG = {
    "two numbers": (lambda _: light_basis([[0, 0]], "ptm"), "3 coordinates"),
    "no length": (lambda _: light_basis([0, 0, 0], "ptm"), "no length"),
    "behind": (lambda _: light_basis([0, 0, -1], "ptm"), "above the horizon"),
    "nan": (lambda _: light_basis([0, np.nan, 1], "ptm"), "not finite"),
    "basis": (lambda _: light_basis([0, 0, 1], "sh"), "a basis is one of"),
    "albedo": (lambda ball: fit_normals(ball, np.ones((4, 4))), "an albedo of shape"),
    "terms": (
        lambda _: RelightableImage("ptm", np.zeros((4, 4, 5), "f4")),
        "coefficients of shape",
    ),
    "basis of a file": (lambda _: write_ptm("x.ptm", OTHER), "has the basis 'ptm'"),
    "quality": (lambda _: write_rti_planes(".", OTHER, [[0, 0, 1]], quality=0), "quality"),
}


@pytest.mark.parametrize("name", WRONG)
def test_bad_arguments(ball, name):
    call, message = WRONG[name]
    with pytest.raises(DataError, match=message):
        call(ball)


def test_a_black_surface_is_refused(ball):
    with pytest.raises(EstimateError, match="black"):
        fit_normals(ball, np.zeros((48, 48)))


# Two pixels, the lower one first: 2 x (byte - 1), and for 1 also minus 100; colours in the end.
HEADER = b"PTM_1.2\nPTM_FORMAT_LRGB\n1\n2\n2 2 2 2 2 2 \n1 1 1 1 1 101\n"
LOWER, UPPER = bytes([1, 1, 1, 1, 51, 151]), bytes([11, 1, 1, 26, 1, 201])
COLOURS = bytes([255, 0, 51]) + bytes([51, 255, 255])
GOLDEN = HEADER + LOWER + UPPER + COLOURS


def test_a_golden_file(tmp_path):
    """Values by hand: 2 x 50 = 100 below and 2 x 100 = 200 above, under a light in front."""
    path = tmp_path / "a.ptm"
    path.write_bytes(GOLDEN)
    upper, lower = 255 * read_ptm(path).relit([0, 0, 1])[:, 0]
    np.testing.assert_allclose(upper, [40, 200, 200], atol=1e-3)
    np.testing.assert_allclose(lower, [100, 0, 20], atol=1e-3)
    # v = .6 adds 2 x 50 x .6 below; u = .6 adds 2 x 10 x .36 + 2 x 25 x .6 above.
    np.testing.assert_allclose(255 * read_ptm(path).relit([0, 3, 4])[1, 0, 0], 160, atol=1e-3)
    np.testing.assert_allclose(255 * read_ptm(path).relit([3, 0, 4])[0, 0, 1], 237.2, atol=1e-3)
    # One line for the size, one for all factors, as the description allows; carriage returns.
    other = b"PTM_1.2\r\nPTM_FORMAT_LRGB\r\n1 2\r\n2 2 2 2 2 2 1 1 1 1 1 101\r\n"
    path.write_bytes(other + GOLDEN[len(HEADER) :] + b"\n")
    np.testing.assert_allclose(255 * read_ptm(path).relit([0, 0, 1])[0, 0], upper, atol=1e-3)
    # Version 1.1 has the nine bytes of a pixel together.
    pixels = LOWER + COLOURS[:3] + UPPER + COLOURS[3:]
    path.write_bytes(HEADER.replace(b"1.2", b"1.1") + pixels)
    np.testing.assert_allclose(255 * read_ptm(path).relit([0, 0, 1])[0, 0], upper, atol=1e-3)
    # RGB has all pixels of red, then green, then blue.
    rgb = HEADER.replace(b"LRGB", b"RGB") + LOWER + UPPER + (UPPER + LOWER) * 2
    path.write_bytes(rgb)
    found = 255 * read_ptm(path).relit([0, 0, 1])[:, 0]
    np.testing.assert_allclose(found, [[200, 100, 100], [100, 200, 200]], atol=1e-3)


def test_the_written_bytes(tmp_path):
    """Two pixels, decoded by hand: the lower one first; u², v², uv, u, v, 1; then the colours."""
    coefficients = np.float32([[[0.5, 0.25, 0, 0, 0, 0]], [[0.75, 0, -0.25, 0, 0, 0]]])
    colour = np.float32([[[1, 0.2, 0]], [[0, 0.4, 1]]])
    write_ptm(tmp_path / "a.ptm", RelightableImage("ptm", coefficients, colour))
    *head, body = (tmp_path / "a.ptm").read_bytes().split(b"\n", 6)
    assert head[:4] == [b"PTM_1.2", b"PTM_FORMAT_LRGB", b"1", b"2"]
    assert all(bias.isdigit() for bias in head[5].split())
    scale, bias = (np.array(line.split(), float) for line in head[4:])
    samples = np.frombuffer(body, np.uint8).astype(float)
    values = (samples[:12].reshape(2, 6) - bias) * scale
    found = values[:, :, None] * samples[12:].reshape(2, 1, 3) / 255
    lower = np.outer([0, 0, 0, 0, -0.25, 0.75], [0, 0.4, 1])
    upper = np.outer([0, 0, 0, 0.25, 0, 0.5], [1, 0.2, 0])
    np.testing.assert_allclose(found, 255 * np.stack([lower, upper]), atol=0.8)


@pytest.mark.parametrize("shared", [True, False], ids=["lrgb", "rgb"])
def test_bytes_of_functions_deviate_as_their_limit_says(shared):
    """Under any light, also of wild functions and of black pixels, and not only on average."""
    random = np.random.default_rng(4)
    functions = random.normal(scale=0.2, size=(400, 6)).astype(np.float32) + np.eye(6)[0] * 0.5
    functions[:9], functions[9] = random.normal(scale=3, size=(9, 6)), 0
    functions = functions.astype(np.float32)
    colour = random.uniform(0, 1, (400, 3)).astype(np.float32) if shared else None
    if colour is not None:
        colour[::3], colour[10] = colour[::3, :1], 0
    made = ptm_bytes(functions, colour)
    decoded = (made.samples - made.bias) * made.scale
    tint = np.ones((400, 3)) if colour is None else colour
    for light in [[0, 0, 1], *hemisphere(300, 1)]:
        weights = light_basis(light, "ptm")
        expected = (functions @ weights)[:, None] * tint
        found = (decoded @ weights)[:, None] * (made.colour / 255 if shared else 1)
        over = np.abs(found - expected).max(axis=1) - 1.02 * made.bound
        assert over.max() < 1e-5, light
    assert made.bound[10 if shared else 9] < 1 / 255


DAMAGED = {
    "empty": (b"", "does not begin with PTM_1.2"),
    "text": (b"hello\n" * 9, "does not begin with PTM_1.2"),
    "compressed": (GOLDEN.replace(b"LRGB", b"JPEG_LRGB"), "PTM_FORMAT_JPEG_LRGB: only"),
    "version": (GOLDEN.replace(b"1.2", b"1.3"), "PTM_1.3"),
    "short": (GOLDEN[:-1], "1 bytes are missing"),
    "long": (GOLDEN + b"xyz", "3 bytes too many"),
    "no body": (HEADER, "18 bytes are missing"),
    "header cut": (HEADER[:-6], "cut short or damaged"),
    "words": (GOLDEN.replace(b"2 2 2", b"x 2 2"), "cut short or damaged"),
    "number": (GOLDEN.replace(b"2 2 2", b"2e+e 2 2"), "a number cannot be read"),
    "infinite": (GOLDEN.replace(b"2 2 2", b"1e999 2 2"), "out of range"),
    "huge scale": (GOLDEN.replace(b"2 2 2", b"1e30 2 2"), "out of range"),
    "huge size": (GOLDEN.replace(b"\n1\n2\n", b"\n100000\n100000\n"), "10000 x|100000 x"),
    "no size": (GOLDEN.replace(b"\n1\n2\n", b"\n0\n2\n"), "0 x 2 pixels"),
    "negative": (GOLDEN.replace(b"\n1\n2\n", b"\n-1\n-2\n"), "-1 x -2 pixels"),
    "half": (GOLDEN.replace(b"\n1\n2\n", b"\n1.5\n2\n"), "not a whole number"),
    "digits": (GOLDEN.replace(b"\n1\n2\n", b"\n" + b"9" * 4000 + b"\n2\n"), "cut short or damaged"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_files(tmp_path, name):
    data, message = DAMAGED[name]
    path = tmp_path / "a.ptm"
    path.write_bytes(data)
    with pytest.raises(DataError, match=message) as refused:
        read_ptm(path)
    assert str(refused.value).startswith(f"{path}: not a readable polynomial texture map: ")
    with pytest.raises(MissingPathError, match="no such file"):
        read_ptm(tmp_path / "b.ptm")


def test_the_limit_of_pixels(tmp_path):
    (tmp_path / "a.ptm").write_bytes(GOLDEN)
    with pytest.raises(DataError, match="2 pixels, 1 are allowed"):
        read_ptm(tmp_path / "a.ptm", max_pixels=1)
