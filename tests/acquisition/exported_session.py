"""A small session with near lights, and what an export of it should contain."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from acquisition import CameraModel, Lights, Session, make_folder, write_exr, write_png
from acquisition.plan import PlannedShot
from acquisition.session import (
    CameraModelRecord,
    CameraReport,
    LightsRecord,
    Manifest,
    SessionWriter,
)
from acquisition.values import led_id
from rig import Mounting
from rig.arrays import Bool, Float32, UInt16

SIZE = (20, 28)
LEDS = (0, 1, 3, 4)  # 2 is dead
K = np.array([[90.0, 0, 14], [0, 90, 10], [0, 0, 1]])
NEAR = Lights(
    positions_mm=np.array([[10.0, 0, 100], [0, 20, 90], [-30, 1 / 3, 80], [0, -40, 70]]),
    intensities=np.array([[1, 2, 3], [0.1, 0.2, 0.3], [5, 5, 5], [1 / 3, 1, 1]]),
    mu=np.array([0, 1, 2, 0.5]),
    ids=tuple(map(led_id, LEDS)),
)
TEXTS = {
    "operator": "Ada L.",
    "object": "Öwl <coin> & \u2603",
    "place": "Rome, room 3",
    "notes": "two\nlines",
    "rights": "CC BY 4.0",
}


def picture(number: int, shape: tuple[int, ...], largest: int = 4095) -> UInt16:
    return (
        np.random.default_rng(number).integers(0, largest, shape, endpoint=True).astype(np.uint16)
    )


def session(
    folder: Path,
    *,
    lights: Lights | None = NEAR,
    channels: int = 1,
    cfa: str | None = None,
    brackets: tuple[float, ...] = (1000.0,),
    unlit: tuple[str, ...] = ("dark",),
    mounting: Mounting | None = None,
    black: float = 64.0,
    maps: bool = True,
) -> Path:
    height, width = SIZE
    rig = {"name": "r", "driver": "d", "board": "b", "protocol": "2", "firmware": "f", "leds": 5}
    upright = (mounting or Mounting()).upright_shape(SIZE)
    manifest = Manifest(
        started_utc=datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC),
        rig=None if mounting is None else {**rig, "mounting": mounting},
        camera={
            "width": width,
            "height": height,
            "channels": channels,
            "bit_depth": 12,
            "cfa": cfa,
            "black_level_dn": black,
            "white_level_dn": 4000.0,
            "vendor": "Acme",
            "serial": "17",
        },
        camera_model=CameraModelRecord.of(CameraModel(K, upright[1], upright[0], 300.0)),
        lights=None if lights is None else LightsRecord.of(lights),
        **TEXTS,
    )
    shots = [
        PlannedShot(role, None, bracket, 0, exposure)
        for role in unlit
        for bracket, exposure in enumerate(brackets)
    ]
    shots += [
        PlannedShot("light", led, bracket, 0, exposure)
        for bracket, exposure in enumerate(brackets)
        for led in LEDS
    ]
    with SessionWriter.create(folder, manifest) as writer:
        for number, shot in enumerate(shots):
            largest = 100 if shot.role != "light" else 4095
            writer.write_frame(
                shot,
                picture(number, manifest.camera.shape, largest),
                report=CameraReport(gain_db=3.0),
            )
        if maps:
            make_folder(folder / "derived" / "truth")
            mask = np.zeros(upright, np.uint8)
            mask[3:9, 4:12] = 255
            write_png(folder / "derived" / "mask.png", mask)
            write_exr(folder / "derived" / "truth" / "normals.exr", true_normals(mask > 0))
        writer.complete()
    return folder


def true_normals(mask: Bool) -> Float32:
    normals = np.random.default_rng(5).normal(size=(*mask.shape, 3))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    return np.where(mask[..., None], normals, 0).astype(np.float32)


def lit(folder: Path, bracket: int = 0) -> dict[int, UInt16]:
    """Pixels by LED."""
    return {
        frame.led: frame.read()
        for frame in Session.open(folder).frames
        if frame.led is not None and frame.bracket == bracket
    }


def same_lights(one: Lights | None, two: Lights | None) -> None:
    assert one is not None
    assert two is not None
    assert one.ids == two.ids
    for name in ("directions", "positions_mm", "intensities", "axes", "mu"):
        mine, theirs = getattr(one, name), getattr(two, name)
        assert (mine is None) == (theirs is None), name
        if mine is not None:
            np.testing.assert_allclose(theirs, mine, rtol=0, atol=1e-15, err_msg=name)
