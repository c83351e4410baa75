"""A session of three frames, and what must hold after its compaction."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from acquisition import CapturePlan, Session, verify_session
from acquisition.session import Manifest, SessionWriter
from rig.arrays import UInt16

SHAPE = (24, 32)
PLAN = CapturePlan(repeat=False, leds=(0, 1), exposures_us=(100.0,))


def picture(seed: int, shape: tuple[int, ...] = SHAPE, above: int = 40) -> UInt16:
    """Return grey values below ``above``: the default ones are compressed well by deflate."""
    return np.random.default_rng(seed).integers(0, above, shape).astype(np.uint16)


def manifest(
    shape: tuple[int, int] = SHAPE, bit_depth: int = 16, *, camera: Any = None, **fields: Any
) -> Manifest:
    """Return the manifest of a coin that Ada recorded, with a camera of this shape."""
    device = {"width": shape[1], "height": shape[0], "bit_depth": bit_depth}
    values = {"started_utc": datetime(2026, 1, 2, tzinfo=UTC), "operator": "Ada", "object": "coin"}
    return Manifest(**{**values, "camera": camera or device, **fields})


def write(folder: Path, *, plan: CapturePlan | None = PLAN, complete: bool = True) -> Path:
    shots = (plan or PLAN).shots()
    shots = shots if complete else shots[:2]
    with SessionWriter.create(folder, manifest(plan=plan)) as writer:
        for index, shot in enumerate(shots):
            writer.write_frame(shot, picture(index))
        if complete:
            writer.complete()
    return folder


def pixels_hold(folder: Path) -> None:
    session = Session.open(folder)
    for index, frame in enumerate(session.recorded):
        np.testing.assert_array_equal(frame.read(), picture(index))


def whole(folder: Path) -> bool:
    """Check that no frame is lost or damaged; return whether the session is complete."""
    found = verify_session(folder)
    assert found.problems == ()
    pixels_hold(folder)
    return found.complete


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in (folder / "frames").iterdir())
