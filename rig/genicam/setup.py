"""Setup of a camera when it is opened."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from rig._errors import CameraError
from rig.camera.interface import CameraInfo
from rig.genicam.nodes import Nodes
from rig.genicam.pixels import PixelFormat, best_format
from rig.genicam.settings import EXPOSURE, TRIGGER_NODES, Settings
from rig.genicam.system import FoundCamera

_NEEDED: tuple[tuple[str, ...], ...] = (
    ("Width",),
    ("Height",),
    ("PixelFormat",),
    ("AcquisitionStart",),
    ("AcquisitionStop",),
)


@dataclass(frozen=True)
class CameraOptions:
    """Settings of a camera, applied when it is opened.

    Parameters
    ----------
    pixel_format
        Name of a raw format, for instance Mono12p; None for the best that the camera offers.
    trigger_line
        The camera's trigger source that is wired to the LED board.
    frame_rate_hz
        Limit of the frame rate; None for no limit.
    black_level
        Black level in the camera's own unit; None leaves it unchanged.
    readout_us
        Readout time of a rolling shutter; None queries the camera.
    most_bytes
        Memory that pending frames may take; None for 1 GiB, or a quarter of the computer's memory
        if that is less.
    needs
        Required abilities of the camera: "exposure", "trigger". Without "trigger" the camera runs
        freely, and `GenICamCamera.trigger` returns the id of its next frame: sufficient for a
        preview, not for a recording.
    """

    pixel_format: str | None = None
    trigger_line: str = "Line0"
    frame_rate_hz: float | None = None
    black_level: float | None = None
    readout_us: float | None = None
    most_bytes: int | None = None
    needs: Collection[str] = ("exposure", "trigger")


def check_needs(nodes: Nodes, found: FoundCamera, needs: Collection[str]) -> None:
    """Check that a camera has all nodes for the required abilities.

    Raises
    ------
    CameraError
        If it lacks any; the message names all of them.
    """
    needed = list(_NEEDED)
    if "exposure" in needs:
        needed.append(EXPOSURE)
    if "trigger" in needs:
        needed += TRIGGER_NODES
    lacking = [names[0] for names in needed if not nodes.exists(names)]
    if lacking:
        raise CameraError(
            f"camera {found} cannot be used, because it lacks nodes: {', '.join(lacking)}"
        )


def set_up(
    nodes: Nodes, settings: Settings, found: FoundCamera, options: CameraOptions
) -> tuple[CameraInfo, PixelFormat]:
    """Apply the options, and return the properties of the camera and its pixel format.

    Raises
    ------
    CameraError
        If an option is not available.
    """
    form = _choose_format(nodes, options.pixel_format)
    if options.black_level is not None:
        settings.set_black_level(options.black_level)
    settings.set_frame_rate(options.frame_rate_hz)
    shutter = settings.shutter()
    readout_us = 0.0
    if shutter == "rolling":
        stated_us = options.readout_us
        readout_us = settings.readout_us() if stated_us is None else stated_us
    low_us, high_us = settings.exposure_range_us()
    info = CameraInfo(
        vendor=found.vendor,
        model=found.model,
        serial=found.serial,
        width=int(nodes.number("Width")),
        height=int(nodes.number("Height")),
        pixel_format=form.name,
        bit_depth=form.depth,
        cfa=form.cfa,
        exposure_min_us=low_us,
        exposure_max_us=high_us,
        shutter=shutter,
        readout_us=readout_us,
        trigger_delay_us=settings.trigger_delay_us(),
        frame_period_us=settings.frame_period_us(),
    )
    return info, form


def _choose_format(nodes: Nodes, wanted: str | None) -> PixelFormat:
    offered = nodes.choices("PixelFormat")
    name = wanted or best_format(offered)
    if name is None:
        raise CameraError(
            f"camera {nodes.camera}, PixelFormat: the camera offers no format of raw samples, for "
            f"instance Mono12 or BayerRG12p, only {', '.join(offered) or 'nothing'}: use another "
            "camera"
        )
    form = PixelFormat.of(name)
    if form is None:
        raise CameraError(
            f"camera {nodes.camera}, PixelFormat: must be a format of raw samples, for instance "
            f"Mono12 or BayerRG12p, not {name}; the camera offers {', '.join(offered)}"
        )
    nodes.set_choice("PixelFormat", form.name)
    return form
