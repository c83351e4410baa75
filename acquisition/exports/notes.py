"""Metadata of an export: recording.json, remarks about the layout, and EXR attributes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from acquisition.exports.values import Samples
from acquisition.session.manifest import CameraRecord
from acquisition.session.session import Session
from acquisition.session.session_frame import SessionFrame
from acquisition.session.value_records import TransferRecord
from acquisition.source.recording_json import LABELS, RECORD_FILE, ExportedFrame, RecordingNotes
from acquisition.source.source import Frame, Source
from acquisition.values.lights import Lights, led_id
from acquisition.values.transfer_curve import LINEAR
from rig import Notice

Layout = Literal["diligent", "lp", "exr", "alicevision"]
Pair = tuple[SessionFrame, Frame]

LIGHTS_FILE: Final = "lights.json"
CAMERA_FILE: Final = "camera.json"
_CLIPPED = 0.001  # share of saturated samples above which a remark is made


def recording_notes(
    session: Session, source: Source, pairs: Sequence[Pair], layout: Layout, samples: Samples
) -> RecordingNotes:
    """Describe the images of an export, each with the shot that it shows."""
    manifest = session.manifest
    height, width = source.size
    kept = manifest.camera.model_dump(include={"vendor", "model", "serial", "channels"})
    levels = samples.levels(layout, manifest.camera.bit_depth)
    camera = CameraRecord.model_validate(
        {**kept, "width": width, "height": height, "cfa": source.cfa, **levels}
    )
    of_line = set(ExportedFrame.model_fields) - {"file"}
    frames = [
        ExportedFrame(
            file=_file(layout, number, recorded), **recorded.line.model_dump(include=of_line)
        )
        for number, (recorded, _) in enumerate(pairs, 1)
    ]
    return RecordingNotes(
        values=samples.values,
        subtracted=samples.subtracted([frame for _, frame in pairs]),
        **manifest.model_dump(include={*LABELS, "started_utc"}),
        camera=camera,
        origin="simulated" if manifest.simulated else None,
        transfer=None if samples.transfer == LINEAR else TransferRecord.of(samples.transfer),
        lights_file=None if source.lights is None else LIGHTS_FILE,
        camera_file=None if source.calibrated_camera is None else CAMERA_FILE,
        remarks=(),
        frames=tuple(frames),
    )


def layout_remarks(
    session: Session, source: Source, pairs: Sequence[Pair], layout: Layout, samples: Samples
) -> list[Notice]:
    """Return remarks on what the layout loses or changes that its readers cannot see."""
    remarks = []
    near = source.lights is not None and source.lights.near
    if near and layout != "exr":
        text = (
            f"layout {layout} cannot store the positions of the lights: it gets directions from "
            f"the origin, and {LIGHTS_FILE} has the positions"
        )
        remarks.append(Notice("export-without-positions", text))
    if source.cfa is not None and layout != "exr":
        text = (
            f"layout {layout} cannot store the colour filter of the mosaic frames ({source.cfa}): "
            f"{RECORD_FILE} names it"
        )
        remarks.append(Notice("export-without-colour-filter", text))
    exposures = {frame.exposure_us for _, frame in pairs if frame.role == "light"}
    if layout in ("diligent", "alicevision") and len(exposures) > 1 and None not in exposures:
        text = (
            "the lights differ in exposure: each intensity is multiplied by its exposure "
            "divided by the longest"
        )
        remarks.append(Notice("intensities-scaled", text, severity="info"))
    if (
        layout == "lp"
        and source.lights is not None
        and np.ptp(np.asarray(source.lights.intensities))
    ):
        text = f"an .lp file holds no intensities: they are in {LIGHTS_FILE}"
        remarks.append(Notice("export-without-intensities", text))
    if layout == "diligent" and source.mask is None:
        text = "mask.png is not written because no mask is known: give a mask"
        remarks.append(Notice("export-without-mask", text))
    clipped = max(recorded.line.clipped_fraction for recorded, _ in pairs)
    if clipped > _CLIPPED:
        text = f"up to {clipped:.1%} of a frame's samples are saturated"
        remarks.append(Notice("frames-saturated", text))
    return remarks


def exr_attributes(
    notes: RecordingNotes, noted: ExportedFrame, lights: Lights | None, light: str
) -> dict[str, Any]:
    """Return the attributes of an EXR file in addition to its caption."""
    attributes: dict[str, Any] = {
        "sgp:role": noted.role,
        "sgp:bracket": noted.bracket,
        "sgp:values": notes.values,
        "sgp:subtracted": notes.subtracted,
        "sgp:black_level": notes.camera.black_level_dn,
        "sgp:white_level": notes.camera.white_dn,
        "sgp:cfa": notes.camera.cfa,
        "sgp:transfer": "linear" if notes.transfer is None else notes.transfer.value().name,
    }
    if noted.led is not None:
        attributes["sgp:led"] = noted.led
    if lights is not None and light in lights.ids:
        index = lights.ids.index(light)
        triples = {
            "direction": lights.unit_directions,
            "intensity": lights.intensities,
            "position_mm": lights.positions_mm,
        }
        for name, values in triples.items():
            if values is not None:
                attributes[f"sgp:light_{name}"] = tuple(values[index].tolist())
    return attributes


def _file(layout: Layout, number: int, recorded: SessionFrame) -> str:
    match layout:
        case "diligent":
            return f"{number:03d}.png"
        case "exr":
            return f"{Path(recorded.line.shot.file).stem}.exr"
    return f"{led_id(recorded.led or 0)}.png"
