"""Values that users handle in a notebook are shown in one short line."""

from __future__ import annotations

import re
from dataclasses import fields, is_dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import get_origin

import numpy as np
import pytest

import acquisition
import calibration
import processing
import rig
import simulator
from rig import Notice, arrays, short_repr
from tests.public_names import public_values

GOLDEN = Path(__file__).parents[1] / "acquisition" / "golden_session_3"
LONGEST = 160
_ALIASES = [name for name, kind in vars(arrays).items() if get_origin(kind) is np.ndarray]
# Annotations of arrays, not of functions that return one.
_ARRAY = re.compile(rf"^(?!Callable).*\b(NDArray|{'|'.join(_ALIASES)})\b")

ONES = np.ones((4, 5), np.float32)
MASK = np.ones((4, 5), np.bool_)
NORMALS = processing.NormalMap.from_vectors(np.tile([0.0, 0.0, 1.0], (4, 5, 1)))
LIGHTS = acquisition.Lights(directions=np.eye(3))
CAMERA = acquisition.CameraModel(
    K=np.array([[100.0, 0, 2], [0, 100, 1.5], [0, 0, 1]]), width=5, height=4,
    working_distance_mm=600,
)  # fmt: skip
NOISE = acquisition.NoiseModel(2.0, 5.0, 60.0, 12)
NOTICE = Notice("mask", "text")
FRAME = rig.CameraFrame(np.zeros((4, 5), np.uint16), 7, 123, 1000.0, 0.0, None)
PLAN = acquisition.CapturePlan(repeat=False, leds=tuple(range(36)), exposures_us=(1000.0, 50.0))
SOURCE = acquisition.Source(
    Path("/in"), "images", (acquisition.Frame(Path("/in/a.png"), "a", (4, 5)),), LIGHTS, MASK
)
STEREO = processing.PhotometricStereoResult(NORMALS, ONES, ONES, MASK.astype(np.uint16), (NOTICE,))
BARS = processing.noise.NormalUncertainty(
    ONES, ONES, np.ones((6, 4, 5), np.uint8), MASK.astype(np.uint8), "sensor", -0.1
)
SEPARATION = processing.Separation(NORMALS, NORMALS, processing.ShapeFilter(order=2))
HEIGHT = processing.HeightMap(
    {"height": ONES, "parts": MASK.astype(np.int32)}, MASK, "mm", 0.5, None, 9, 1e-6, ()
)
QUALITY = processing.checks.ImageQuality(
    0.02,
    0.01,
    0.9,
    ONES[0, :3],
    ONES[0, :3],
    ONES[0, :3],
    0.1,
    LIGHTS.ids,
    processing.checks.Explanation(),
)
ERROR = processing.AngularError(8.394, 6.0, 1.0, ONES)

EXAMPLES: list[tuple[object, str]] = [
    (FRAME, "CameraFrame(pixels=uint16[4, 5], frame_id=7, timestamp_ns=123, exposure_us=1000, "
            "gain_db=0)"),
    (rig.Shot(FRAME, 3, None), f"Shot(LED 3, {FRAME!r})"),
    (rig.RigConfig(name="bench", driver="x", led_positions_mm=tuple((n, 0, 9) for n in range(36))),
     "RigConfig(bench, driver x, 36 LEDs)"),
    (LIGHTS, "Lights(3 directions, L00 to L02)"),
    (acquisition.Lights(positions_mm=[[0.0, 0, 300]], ids=("lamp",)),
     "Lights(1 position in mm, lamp)"),
    (CAMERA, "CameraModel(5 x 4 px, focal length 100.0 px, working distance 600 mm)"),
    (NOISE, "NoiseModel(2 e/DN, read noise 5 e, black level 60 DN, 12 bit)"),
    (PLAN, "CapturePlan(36 LEDs, 2 brackets, 74 shots)"),
    (SOURCE, "Source(/in, images, 1 frame of 5 x 4 px, lights, mask)"),
    (SOURCE.frames[0],
     "Frame(path=/in/a.png, light_id='a', shape=(4, 5), role='light', bracket=0)"),
    (acquisition.Labels("Ada", "coin"),
     "Labels(operator='Ada', object_name='coin', place='', notes='', rights='')"),
    (acquisition.mesh_files.MeshFile(np.eye(3), np.array([[0, 1, 2]]), warnings=(NOTICE,)),
     "MeshFile(vertices=float64[3, 3], faces=int64[1, 3], warnings=1 item)"),
    (acquisition.pixels.RawFrame(np.zeros((4, 5), np.uint16), "RGGB", 1.0, 255.0, (1.0,) * 4,
                          taken=datetime(2026, 1, 2, tzinfo=UTC)),
     "RawFrame(pixels=uint16[4, 5], cfa='RGGB', black_level_dn=1, white_level_dn=255, "
     "black_levels_dn=(1, 1, 1, 1), taken=2026-01-02 00:00:00+00:00)"),
    (calibration.Stack(np.zeros((3, 4, 5), np.float32), ("a", "b", "c"), LIGHTS),
     "Stack(float32[3, 4, 5], lights)"),
    (calibration.intensities.IntensityCalibration(LIGHTS, 1.5, MASK[0], MASK[1], 0.1, 2.0, 0.01,
                                                  900, None, ()),
     "IntensityCalibration(Lights(3 directions, L00 to L02), mu 1.50, residual 1.00%, "
     "900 pixels)"),
    (NORMALS, "NormalMap(float32[4, 5, 3], 20 normals)"),
    (processing.NormalMapFile(NORMALS, (), (Path("/n.exr"),)),
     f"NormalMapFile(normal_map={NORMALS!r}, files=1 item)"),
    (STEREO, f"PhotometricStereoResult(normal_map={NORMALS!r}, albedo=float32[4, 5], "
             "residual=float32[4, 5], used=uint16[4, 5], warnings=1 item)"),
    (SEPARATION, f"Separation({NORMALS!r}, {SEPARATION.shape_filter!r})"),
    (processing.detail.TransferFidelity(NORMALS, NORMALS, SEPARATION),
     f"TransferFidelity({SEPARATION!r})"),
    (QUALITY, "ImageQuality(residual=0.02, consistency=0.01, used=0.9, image_residual=float32[3], "
              "light_error_deg=float32[3], light_gain=float32[3], curl=0.1, ids=3 items)"),
    (ERROR, "AngularError(mae_deg=8.394, median_deg=6, coverage=1, map_deg=float32[4, 5])"),
    (processing.curvatures.curvature(NORMALS, pixel_mm=0.1),
     "Curvature(float32[4, 5] in 1/mm, scale 2 px)"),
    (HEIGHT, "HeightMap(float32[4, 5] in mm, pixel size 0.5 mm)"),
    (processing.meshes.Mesh(np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.int32)),
     "Mesh(vertices=float32[3, 3], faces=int32[1, 3], unit='px')"),
    (processing.Reconstruction(SOURCE, LIGHTS, MASK, MASK, {}, "sensor", 0.0, QUALITY,
                               processing.checks.Verdict((), 0.3, 0.02, 0.02), (), None,
                               ERROR, (), None, (), None, HEIGHT),
     f"Reconstruction(/in, {NORMALS!r}, height in mm, mean error 8.39 deg)"),
    (simulator.scene_named("coin"), "Scene(Coin, 36 lights, 0 spheres, 640 x 512 px)"),
    (simulator.Lens(camera=CAMERA),
     f"Lens(camera={CAMERA!r}, vignetting=0, psf_sigma_px=0.7, optics=Optics(...), sharp=True)"),
    (simulator.Truth(NORMALS.normals, ONES, ONES, MASK, MASK[None], np.eye(1, 3), np.ones(1),
                     np.zeros((3, 1, 2)), LIGHTS, simulator.Lens(camera=CAMERA), NOISE, 1.0),
     "Truth(float32[4, 5, 3], 3 lights, 1 sphere)"),
    (simulator.camera.ImageFormation(NOISE),
     f"ImageFormation(noise={NOISE!r}, seed=0, noisy=True, lamps=Lamps(...), shake_px=0, "
     "sensor_seed=0)"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("value", "shown"), EXAMPLES, ids=[type(value).__name__ for value, _ in EXAMPLES]
)
def test_a_value_is_shown_in_one_short_line(value: object, shown: str) -> None:
    assert repr(value) == shown
    assert len(shown) <= LONGEST


def test_a_session_and_its_parts_are_shown_in_one_short_line() -> None:
    session = acquisition.Session.open(GOLDEN)
    checked, source = acquisition.verify_session(GOLDEN), acquisition.read_source(GOLDEN)
    shown: list[tuple[object, str]] = [
        (session, f"Session({GOLDEN}, 9 frames, complete)"),
        (session.manifest, "Manifest(coin 7, 2026-03-04 05:06 UTC, format 3)"),
        (session.frames[0], "SessionFrame(D_100us.tif, dark, 99.5 us, shape (6, 8))"),
        (session.recorded[3], "SessionFrame(L03_E0_R1.tif, light, LED 3, 100 us, shape (6, 8))"),
        (session.frames[0].line, "FrameLine(2, frames/D_100us.tif, ok)"),
        (session.events[0], "EventLine(1, checked)"),
        (checked, f"Verification({GOLDEN}, complete, 13 frames, 0 problems)"),
        (source, f"Source({GOLDEN}, session, 9 frames of 6 x 8 px, lights)"),
    ]
    assert [repr(value) for value, _ in shown] == [text for _, text in shown]


def test_no_public_class_shows_the_numbers_of_an_array() -> None:
    """A dataclass with an array has a representation of its own, or `rig.short_repr`."""
    assert [
        name
        for name, kind in public_values()
        if isinstance(kind, type)
        and is_dataclass(kind)
        and hasattr(kind.__repr__, "__wrapped__")  # made by @dataclass
        and any(field.repr and _ARRAY.search(str(field.type)) for field in fields(kind))
    ] == []


def test_long_texts_are_cut() -> None:
    check = acquisition.preflights.Check("disk", "ok", "x" * 100, {"bytes": 1, "speed": 2.0})
    assert repr(check) == f"Check(name='disk', state='ok', text='{'x' * 60}...', values=2 items)"
    assert acquisition.preflights.Check.__repr__ is short_repr
