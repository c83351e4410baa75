"""Normals from images in colour, one solution per channel, averaged by their noise."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition import DataError, Frame, Lights, Source, angle_deg
from calibration import EstimateError
from processing import reconstruct
from processing.noise.normal_errors import STRUCTURED
from simulator import bench_sensor
from simulator.camera import sensor_image
from tests.quick_sample import quick

SIZE = (60, 80)
SENSOR = bench_sensor()
TURN = np.radians(np.arange(12) * 30.0)
TILT = np.radians(np.resize([20.0, 40.0], 12))
LIGHTS = Lights(
    directions=np.stack(
        [np.sin(TILT) * np.cos(TURN), np.sin(TILT) * np.sin(TURN), np.cos(TILT)], axis=1
    ),
    intensities=np.linspace([0.7, 0.8, 1.0], [1.0, 0.9, 0.6], 12),
)


@pytest.fixture(autouse=True)
def paths_exist(monkeypatch):
    """The frames are arrays without files."""
    monkeypatch.setattr(Path, "exists", lambda self: True)


def true_normals():
    y, x = np.indices(SIZE, dtype=float)
    normals = np.dstack([0.3 * np.sin(x / 7), 0.3 * np.cos(y / 9), np.ones(SIZE)])
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def source_of(images, normals, **options):
    """Return the source of images, in memory, of the bench sensor under `LIGHTS`."""
    frames = [
        Frame(
            Path(f"/nowhere/frame{i:02d}.tif"), f"L{i:02d}", pixels.shape, "light", 0, 1000.0,
            lambda pixels=pixels: pixels,
        )
        for i, pixels in enumerate(images)
    ]  # fmt: skip
    return Source(
        Path("/nowhere"),
        "images",
        tuple(frames),
        LIGHTS,
        mask=np.ones(normals.shape[:2], bool),
        black_level=SENSOR.black_level_dn,
        white_level=SENSOR.white_level_dn,
        normals_truth=normals.astype(np.float32),
        **options,
    )


def recording(colour, seed=3, noise=True, white=0):
    """Record the waves in one colour; the first columns of red are white."""
    normals, frames = true_normals(), []
    for i, (vector, intensity) in enumerate(
        zip(LIGHTS.directions, LIGHTS.intensities, strict=True)
    ):
        shade = np.clip(normals @ vector, 0, None)[..., None]
        electrons = 0.9 * 4031 * SENSOR.electrons_per_dn * shade * np.multiply(colour, intensity)
        pixels = np.dstack(
            [
                sensor_image(electrons[..., k].astype(np.float32), SENSOR, key=(seed, i, k))
                for k in range(3)
            ]
        )
        pixels[:, :white, 0] = 65535
        frames.append(pixels)
    return source_of(frames, normals, noise=SENSOR if noise else None)


def rms_deg(result):
    return float(np.sqrt(np.mean(angle_deg(result.normals.normals, true_normals()) ** 2)))


def bound_deg(colour):
    """Return the Cramer-Rao bound of the normals from all samples, in degrees."""
    vectors, normals = LIGHTS.unit_directions, true_normals().reshape(-1, 3)
    full_e = 4031 * SENSOR.electrons_per_dn
    information = np.zeros((len(normals), 3, 3))
    for k in range(3):
        shade = np.clip(normals @ vectors.T, 0, None)
        electrons = 0.9 * full_e * shade * colour[k] * LIGHTS.intensities[:, k]
        variance = electrons + SENSOR.read_noise_e**2 + SENSOR.electrons_per_dn**2 / 12
        # Derivatives of the electrons by the normal, for a known albedo of each channel.
        slope = 0.9 * full_e * colour[k] * LIGHTS.intensities[:, k]
        weight = np.where(shade > 0, slope**2 / variance, 0)
        one = np.einsum("pn,ni,nj->pij", weight, vectors, vectors)
        # The albedo of the channel is unknown: remove what it can explain.
        along = np.einsum("pij,pj->pi", one, normals)
        scale = np.einsum("pi,pi->p", along, normals)
        information += one - along[:, :, None] * along[:, None] / scale[:, None, None]
    variance = np.linalg.eigvalsh(information)[:, 1:]
    return float(np.degrees(np.sqrt(np.mean(np.sum(1 / variance, axis=1)))))


@pytest.mark.parametrize(
    "colour",
    quick(
        [
            pytest.param((0.8, 0.8, 0.8), id="gray"),
            pytest.param((0.9, 0.15, 0.05), id="red"),
            pytest.param((0.1, 0.2, 0.8), id="blue"),
        ],
        every=3,
    ),
)
def test_the_average_is_close_to_the_bound_and_better_than_gray(colour):
    average = rms_deg(reconstruct(recording(colour), method="ls", channel="rgb"))
    gray = rms_deg(reconstruct(recording(colour), method="ls", channel="gray"))
    joint = rms_deg(reconstruct(recording(colour), method="ls", channel="joint"))
    assert joint < 1.05 * bound_deg(colour)
    assert joint < 1.005 * average
    assert average < 1.08 * bound_deg(colour)
    assert average < 1.01 * gray


@pytest.mark.parametrize(
    ("colour", "used"), [((0.1, 0.2, 0.8), True), ((0.2, 0.9, 0.1), False)], ids=["blue", "green"]
)
def test_all_colours_are_used_if_they_are_surer_than_gray(colour, used):
    """Luma has the weights of the eye: blue light counts for little, green for most."""
    chosen, gray, joint = (
        reconstruct(recording(colour), method="ls", channel=channel, surface=False)
        for channel in ("auto", "gray", "joint")
    )
    like = joint if used else gray
    np.testing.assert_array_equal(chosen.normals.normals, like.normals.normals)
    assert ("colours-used" in {notice.code for notice in chosen.warnings}) == used
    if used:
        assert rms_deg(chosen) < 0.9 * rms_deg(gray)


@pytest.mark.parametrize("channel", ["rgb", "gray"])
def test_errors_are_as_large_as_predicted(channel):
    result = reconstruct(recording((0.8, 0.3, 0.1), seed=8), method="ls", channel=channel)
    found = result.uncertainty
    assert found.valid.all()
    assert found.neighbour_correlation < 0.1
    error = angle_deg(result.normals.normals, true_normals())[found.valid]
    sigma = found.sigma_deg[found.valid].astype(float)
    for part in np.array_split(np.argsort(sigma), 3):
        ratio = np.sqrt(np.mean(error[part] ** 2) / np.mean(sigma[part] ** 2))
        assert 0.85 < ratio < 1.2


@pytest.mark.parametrize("noise", quick([True, False], every=2))
def test_channels_without_signal_do_not_count(noise):
    with_black = reconstruct(recording((0.8, 0.0, 0.0), noise=noise), channel="rgb")
    red = reconstruct(recording((0.8, 0.8, 0.8), noise=noise), channel="rgb")
    assert rms_deg(with_black) < 2 * rms_deg(red)
    assert with_black.normals.mask.all()
    # A single pixel of noise may be brighter.
    assert np.quantile(with_black.albedo[..., 1:], 0.999) < 0.01


def test_a_channel_is_left_out_where_it_is_saturated():
    result = reconstruct(recording((0.8, 0.8, 0.8), white=40), channel="rgb")
    assert rms_deg(result) < 0.6
    assert not result.albedo[:, :40, 0].any()
    assert (result.used[:, :40] == 0).all()
    assert (result.used[:, 40:] == 12).all()


@pytest.mark.parametrize("channel", ["rgb", "joint"])
def test_the_albedo_in_colour(channel):
    colour = (0.7, 0.4, 0.2)
    result = reconstruct(recording(colour), channel=channel)
    np.testing.assert_allclose(result.albedo.mean(axis=(0, 1)) / 0.9, colour, rtol=0.01)


def test_a_channel_that_is_saturated_everywhere_is_refused():
    with pytest.raises(EstimateError, match="saturated"):
        reconstruct(recording((0.8, 0.8, 0.8), white=SIZE[1]), channel="rgb")


def test_images_of_one_channel_are_refused():
    frame = Frame(Path("/nowhere/a.tif"), "L00", (8, 9), load=lambda: np.full((8, 9), 9, np.uint8))
    source = Source(
        Path("/nowhere"), "images", (frame,), Lights(directions=[[0, 0, 1]]), white_level=255
    )
    with pytest.raises(DataError, match="the image has one channel: use gray"):
        reconstruct(source, channel="rgb")


@pytest.mark.slow
def test_one_channel_that_is_not_matte_is_enough_to_show_it(monkeypatch):
    turn, z = np.arange(24) * np.pi * (3 - np.sqrt(5)), np.linspace(0.98, 0.6, 24)
    r = np.sqrt(1 - z * z)
    directions = np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)
    dome = Lights(directions=directions, intensities=np.ones((24, 3)))
    monkeypatch.setitem(globals(), "LIGHTS", dome)
    source = recording((0.5, 0.5, 0.5))

    def glossy(frame, vector):
        pixels, half = frame.load().copy(), vector + np.array([0, 0, 1])
        lobe = np.clip(true_normals() @ half / np.linalg.norm(half), 0, None) ** 20
        pixels[..., 1] += (0.2 * lobe * pixels[..., 1]).astype(pixels.dtype)
        return replace(frame, load=lambda: pixels)

    frames = tuple(map(glossy, source.frames, directions))
    matte, in_green = (
        reconstruct(one, channel="rgb", method="ls", surface=False).uncertainty
        for one in (source, replace(source, frames=frames))
    )
    assert matte.neighbour_correlation < 0 < 2 * STRUCTURED < in_green.neighbour_correlation
