"""Stacks in bands of rows: equal to the complete stack, and safe if files change."""

import os
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from acquisition import (
    CameraModel,
    CapturePlan,
    DataError,
    Lights,
    StorageError,
    crop,
    downscale,
    read_source,
    write_exr,
    write_png,
)
from acquisition.pixels.plain_rows import plain_rows
from acquisition.session import (
    CameraRecord,
    CameraReport,
    Manifest,
    RigRecord,
    SensorRecord,
    SessionWriter,
    compact_session,
)
from calibration import EstimateError, linear_stack, open_stack
from rig import Mounting
from tests.quick_sample import quick

HEIGHT, WIDTH = 70, 21
SENSOR = SensorRecord(electrons_per_dn=2.5, read_noise_e=3.0, black_level_dn=100.0, bit_depth=12)
BRACKETS = {"exposures_us": (4000.0, 1000.0, 250.0), "leds": (0, 1, 2)}


def session(folder, *, plan, cfa=None, mounting=None):
    """Record noise with saturated blocks and hot pixels."""
    rng = np.random.default_rng(7)
    rig = RigRecord(
        name="bench", driver="serial", board="real", protocol="2", firmware="1", leds=4,
        mounting=mounting,
    )  # fmt: skip
    content = Manifest(
        started_utc=datetime(2026, 1, 2, tzinfo=UTC),
        operator="Ada",
        object="coin",
        plan=CapturePlan(repeat=False, **plan),
        rig=rig,
        camera=CameraRecord(width=WIDTH, height=HEIGHT, bit_depth=12, cfa=cfa, black_level_dn=100),
        sensor=SENSOR,
    )
    light = rng.uniform(200, 3000, (HEIGHT, WIDTH))
    light[30:34, 5:9] = light[:2] = light[63:65, 10:] = 40_000
    with SessionWriter.create(folder, content) as writer:
        for shot in writer.missing:
            level = light * shot.exposure_us / 4000 if shot.role == "light" else 20.0
            pixels = 100 + level + rng.normal(0, 5, (HEIGHT, WIDTH))
            pixels[33, 12] += 900 * shot.exposure_us / 4000  # hot
            frame = np.clip(np.rint(pixels), 0, 4095).astype(np.uint16)
            writer.write_frame(shot, frame, report=CameraReport(exposure_us=shot.exposure_us))
        writer.complete()
    return folder


def images(folder, make, write=write_png, suffix="png"):
    folder.mkdir()
    for i in range(4):
        write(folder / f"L{i}.{suffix}", make(np.random.default_rng(i)))
    return folder


def colours(rng):
    pixels = rng.integers(0, 60_000, (HEIGHT, WIDTH, 3)).astype(np.uint16)
    pixels[20:25, 3:9, 1] = 65_535
    return pixels


ONE = {"exposures_us": (4000.0,), "leds": (0, 1, 2)}
SOURCES = {
    "one exposure": lambda at: read_source(session(at, plan=ONE)),
    "without references": lambda at: read_source(session(at, plan={**ONE, "dark": False})),
    "repeats": lambda at: read_source(session(at, plan={**ONE, "repeats": 3})),
    "brackets": lambda at: read_source(session(at, plan=BRACKETS)),
    "brackets of a mosaic": lambda at: read_source(session(at, plan=BRACKETS, cfa="GRBG")),
    "mosaic": lambda at: read_source(session(at, plan=ONE, cfa="RGGB")),
    "turned": lambda at: read_source(
        session(at, plan=BRACKETS, mounting=Mounting(rotation_deg=90))
    ),
    "region": lambda at: crop(read_source(session(at, plan=BRACKETS)), 3, 5, 15, 61),
    "region of a mosaic": lambda at: crop(
        read_source(session(at, plan=BRACKETS, cfa="RGGB")), 3, 5, 15, 61
    ),
    "averages": lambda at: downscale(read_source(session(at, plan=BRACKETS)), 3),
    "averages of a mosaic": lambda at: downscale(read_source(session(at, plan=ONE, cfa="BGGR")), 3),
    "colour": lambda at: read_source(images(at, colours)),
    "averages of colour": lambda at: downscale(read_source(images(at, colours)), 2),
    "8 bits": lambda at: read_source(
        images(at, lambda rng: rng.integers(0, 256, (HEIGHT, WIDTH)).astype(np.uint8))
    ),
    "floats": lambda at: read_source(
        images(
            at,
            lambda rng: rng.uniform(0, 9, (HEIGHT, WIDTH)).astype(np.float32),
            write_exr,
            "exr",
        )
    ),
}


def compacted(folder):
    compact_session(session(folder, plan=BRACKETS))
    return read_source(folder)


SOURCES["compacted"] = compacted


def check_equal(band, whole):
    assert band.values.dtype == np.float32
    np.testing.assert_array_equal(band.values, whole.values)
    assert (band.ids, band.pattern) == (whole.ids, whole.pattern)
    assert (band.noise is None) == (whole.noise is None)
    if whole.noise is not None:
        for i, image in enumerate(whole.values):
            np.testing.assert_array_equal(
                band.noise.variance(i, image), whole.noise.variance(i, image)
            )


@pytest.mark.parametrize("kind", quick(SOURCES, every=4))
def test_bands_are_the_rows_of_the_complete_stack(tmp_path, kind):
    source = SOURCES[kind](tmp_path / "recording")
    for channel in ("gray", "rgb", "mosaic"):
        three = len(source.frames[0].shape) == 3 or source.cfa is not None
        mosaic = source.cfa is not None and "averages" not in kind
        if (channel == "rgb" and not three) or (channel == "mosaic" and not mosaic):
            continue
        whole = linear_stack(source, channel=channel)
        with open_stack(source, channel=channel) as stack:
            assert stack.values.shape == whole.values.shape
            for rows in (7, 32, 100):
                parts = list(stack.bands(rows))
                assert [where.start for where, _ in parts] == list(
                    range(0, stack.values.shape[1], rows)
                )
                for where, band in parts:
                    check_equal(band, whole.rows(where.start, where.stop))
            np.testing.assert_array_equal(stack.hot_pixels, whole.hot_pixels)
            assert [note.code for note in stack.warnings] == [note.code for note in whole.warnings]


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_rows_in_any_order(brackets_of_a_mosaic, data):
    whole, stack = brackets_of_a_mosaic
    for _ in range(3):
        first = data.draw(st.integers(0, HEIGHT - 1))
        last = data.draw(st.integers(first + 1, HEIGHT))
        check_equal(stack.rows(first, last), whole.rows(first, last))


@pytest.fixture(scope="module", params=["gray", "mosaic"])
def brackets_of_a_mosaic(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("mosaic") / "session"
    source = read_source(session(folder, plan=BRACKETS, cfa="GBRG"))
    with open_stack(source, channel=request.param) as stack:
        yield linear_stack(source, channel=request.param), stack


def test_mask_and_camera_are_those_of_the_rows(tmp_path):
    folder = images(
        tmp_path / "i", lambda rng: rng.integers(1, 9_000, (HEIGHT, WIDTH)).astype(np.uint16)
    )
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[10:40, 4:9] = 255
    write_png(tmp_path / "mask.png", mask)
    K = np.array([[500.0, 0, 10], [0, 500, 34.5], [0, 0, 1]])
    camera = CameraModel(K, WIDTH, HEIGHT, working_distance_mm=600.0)
    lights = Lights(directions=np.eye(3)[[0, 1, 2, 0]] + 1)
    source = read_source(folder, lights=lights, camera=camera, mask_path=tmp_path / "mask.png")
    with open_stack(source) as stack:
        band = stack.rows(8, 20)
    np.testing.assert_array_equal(band.mask, mask[8:20] > 0)
    points = camera.points_on_plane()[8:20]
    np.testing.assert_allclose(band.camera.points_on_plane(), points, atol=1e-9)
    assert band.lights is source.lights


@pytest.mark.parametrize(("first", "last"), [(-1, 4), (4, 4), (5, 3), (0, HEIGHT + 1)])
def test_rows_that_do_not_exist_are_refused(tmp_path, first, last):
    source = SOURCES["one exposure"](tmp_path / "s")
    with open_stack(source) as stack, pytest.raises(ValueError, match=f"no rows from {first} to"):
        stack.rows(first, last)
    with pytest.raises(ValueError, match="no rows"):
        linear_stack(source).rows(first, last)


def frame_of(source):
    return next(frame for frame in source.frames if frame.role == "light").path


def flip(path, at=-3):
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    path.write_bytes(bytes(data))


def cut(path):
    path.write_bytes(path.read_bytes()[:-7])


FAULTS = {
    "one bit": (flip, "its pixels differ from those recorded"),
    "cut short": (cut, "cut short|differ|damaged"),
    "removed": (lambda path: path.unlink(), "is missing: restore it"),
    "a folder": (lambda path: (path.unlink(), path.mkdir()), "not a regular file"),
    "a pipe": (lambda path: (path.unlink(), os.mkfifo(path)), "not a regular file"),
    "empty": (lambda path: path.write_bytes(b""), "empty"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_damaged_frame_is_named_when_the_stack_is_opened(tmp_path, fault):
    source = SOURCES["one exposure"](tmp_path / "s")
    damage, text = FAULTS[fault]
    damage(frame_of(source))
    with pytest.raises(DataError, match=text) as caught:
        open_stack(source)
    assert frame_of(source).name in str(caught.value)


@pytest.mark.parametrize("fault", ["one bit", "cut short", "removed", "a pipe", "empty"])
def test_a_frame_that_changes_afterwards_is_named(tmp_path, fault):
    source = SOURCES["one exposure"](tmp_path / "s")
    with open_stack(source) as stack:
        stack.rows(0, 5)
        FAULTS[fault][0](frame_of(source))
        with pytest.raises(DataError, match=r"was changed|now cannot") as caught:
            stack.rows(5, 9)
    assert frame_of(source).name in str(caught.value)


def test_decoded_frames_are_not_read_again(tmp_path):
    source = SOURCES["colour"](tmp_path / "c")
    whole = linear_stack(source)
    with open_stack(source) as stack:
        frame_of(source).unlink()
        check_equal(stack.rows(3, 9), whole.rows(3, 9))
    with pytest.raises(ValueError, match="closed"):
        stack.rows(3, 9)


def test_a_full_disk_is_named(tmp_path, monkeypatch):
    source = SOURCES["colour"](tmp_path / "c")

    class Full:
        def __getattr__(self, name):
            return lambda *args: None

        def write(self, data):
            raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.TemporaryFile", lambda **options: Full())
    with pytest.raises(StorageError, match=r"cannot keep decoded frames: No space left .* free"):
        open_stack(source)


@pytest.mark.parametrize(
    ("value", "text"), [(0, "all 4 images are black"), (65_535, "every sample of all 4 images")]
)
def test_the_last_band_knows_whether_the_images_can_be_used(tmp_path, value, text):
    made = images(tmp_path / "i", lambda rng: np.full((HEIGHT, WIDTH), value, np.uint16))
    with open_stack(read_source(made)) as stack:
        bands = stack.bands(40)
        assert next(bands)[0] == slice(0, 40)
        assert next(bands)[0] == slice(40, HEIGHT)
        with pytest.raises(EstimateError, match=text):
            next(bands)


def test_every_frame_is_checked_once(tmp_path, monkeypatch):
    source = SOURCES["brackets"](tmp_path / "s")
    opened = []
    monkeypatch.setattr(
        "acquisition.session.session_frame.plain_rows",
        lambda path, *rest: opened.append(path) or plain_rows(path, *rest),
    )
    with open_stack(source) as stack:
        for _ in stack.bands(8):
            pass
        stack.rows(0, 70)
    assert sorted(opened) == sorted(frame.path for frame in source.frames)


@pytest.mark.parametrize("read", [linear_stack, lambda source: [*open_stack(source).bands()]])
@pytest.mark.parametrize("light", [5, 700])
def test_dark_frames_that_are_brighter_than_the_images_are_named(tmp_path, read, light):
    content = Manifest(
        started_utc=datetime(2026, 1, 2, tzinfo=UTC),
        operator="Ada",
        object="coin",
        plan=CapturePlan(repeat=False, **ONE),
        camera=CameraRecord(width=WIDTH, height=HEIGHT, bit_depth=12, black_level_dn=100),
    )
    with SessionWriter.create(tmp_path / "s", content) as writer:
        for shot in writer.missing:
            level = 100 + (light if shot.role == "light" else 900)
            writer.write_frame(shot, np.full((HEIGHT, WIDTH), level, np.uint16))
        writer.complete()
    with pytest.raises(EstimateError, match=r"frames are as bright as all 3 images: check which"):
        read(read_source(tmp_path / "s"))


@pytest.mark.parametrize("kind", ["colour", "brackets of a mosaic", "averages of a mosaic"])
def test_the_law_of_one_channel_is_that_of_the_colours(tmp_path, kind):
    source = SOURCES[kind](tmp_path / "recording")
    if source.noise is None:
        source = replace(source, noise=SENSOR.value())
    stack = linear_stack(source, channel="rgb")
    for i, image in enumerate(stack.values):
        expected = stack.noise.variance(i, image)
        for channel in range(3):
            found = stack.noise.of_colour(channel).variance(i, image[..., channel])
            np.testing.assert_allclose(found, expected[..., channel], rtol=1e-12)
