"""Sessions of computed images, as a rig records them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path

from acquisition import CapturePlan
from acquisition.plan import PlannedShot
from acquisition.session import CameraRecord, CameraReport, Manifest, SensorRecord, SessionWriter
from rig.arrays import AnyArray


def write_session(
    folder: Path,
    name: str,
    frame_of: Callable[[int, PlannedShot], AnyArray],
    *,
    lights: int,
    size: tuple[int, int],
    exposures_us: Sequence[float],
    black_level_dn: int,
    bit_depth: int = 12,
    electrons_per_dn: float = 2.5,
    read_noise_e: float,
) -> None:
    """Record the frames of a sensor, which are computed from the number of a shot and the shot."""
    height, width = size
    content = Manifest(
        started_utc=datetime(2026, 1, 2, tzinfo=UTC),
        operator="benchmark",
        object=name,
        plan=CapturePlan(leds=tuple(range(lights)), exposures_us=tuple(exposures_us)),
        camera=CameraRecord(
            width=width, height=height, bit_depth=bit_depth, black_level_dn=black_level_dn
        ),
        sensor=SensorRecord(
            electrons_per_dn=electrons_per_dn,
            read_noise_e=read_noise_e,
            black_level_dn=float(black_level_dn),
            bit_depth=bit_depth,
        ),
    )
    with SessionWriter.create(folder, content) as writer:
        for number, shot in enumerate(writer.missing):
            report = CameraReport(exposure_us=shot.exposure_us)
            writer.write_frame(shot, frame_of(number, shot), report=report)
        writer.complete()
