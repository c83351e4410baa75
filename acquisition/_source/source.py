"""What every kind of recording becomes before it is processed: frames, lights, mask, camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError
from acquisition._pixels.images import Image, read_image
from acquisition._plan.planned_shot import Role
from acquisition._values.camera_model import CameraModel
from acquisition._values.lights import Lights
from rig import MAX_PIXELS

SourceKind = Literal["session", "diligent", "lp", "images"]
MaskOrigin = Literal["given", "folder", "recording"]


@dataclass(frozen=True, eq=False)
class Frame:
    """One image of a recording, read when asked for.

    Parameters
    ----------
    path
        The file.
    light_id
        ``L07`` for LED 7 of a session, the file's stem elsewhere.
    shape
        ``(H, W)`` or ``(H, W, 3)``, the same for all frames of a source.
    role
        ``light``, ``dark``, ``ambient`` or ``flat``.
    bracket
        Index of the exposure from 0.
    exposure_us
        Exposure time, microseconds; None where not known.
    load
        How to read the pixels, for files that `read_image` does not read.
    max_pixels
        The most that the file may have when it is read.
    """

    path: Path
    light_id: str
    shape: tuple[int, ...]
    role: Role = "light"
    bracket: int = 0
    exposure_us: float | None = None
    load: Callable[[], Image] | None = field(default=None, repr=False)
    max_pixels: int = field(default=MAX_PIXELS, repr=False)

    def read(self) -> Image:
        """Return the pixels as stored: no black level taken off, no scaling.

        Raises
        ------
        DataError
            If the file is gone, damaged, or of another shape than the rest of the source.
        """
        if not self.path.exists():
            raise DataError(f"{self.path}: is gone since the folder was read: restore it")
        if self.load is None:
            pixels = read_image(self.path, max_pixels=self.max_pixels)
        else:
            pixels = self.load()
        if pixels.shape != self.shape:
            raise DataError(
                f"{self.path}: shape {pixels.shape}, the rest of the source has {self.shape}"
            )
        return pixels


@dataclass(frozen=True, eq=False)
class Source:
    """A recording of any kind, ready to be read.

    Parameters
    ----------
    path
        The folder or file that was named.
    kind
        ``session``, ``diligent``, ``lp`` (images with an .lp) or ``images``.
    frames
        All frames that count, at least one; those of a folder in natural order.
    lights
        One light for each of `light_ids`, in that order and with those ids; None where not known.
    mask
        ``(H, W)`` bool, True on the object; None where none came with the images.
    mask_path
        The image file that `mask` was read from; None without a mask.
    mask_origin
        What is known about the mask. ``given``: the caller named the file. ``recording``: it
        belongs to a session, an export, a DiLiGenT folder or an .lp, and shows the object.
        ``folder``: it lies in a plain folder of images, and may show a chrome sphere as well as an
        object. None without a mask.
    camera
        The camera as geometry, where known; it has the size of the images.
    normals_truth
        ``(H, W, 3)`` float32 unit normals, 0 where not known; None where there is no truth.
    cfa
        Colour filter pattern of mosaic frames, row by row from the top left; None elsewhere.
    black_level, white_level
        Grey values without light and at saturation, in the unit of the files. The white level of
        float images is infinite: no sample is saturated, and their values are taken as they are.
    files
        Every file that was read, or is read through `frames`.
    ignored
        Names in the folder that were not used. Of a session nothing is told.
    warnings
        What was assumed, one line each.
    """

    path: Path
    kind: SourceKind
    frames: tuple[Frame, ...]
    lights: Lights | None = None
    mask: npt.NDArray[np.bool_] | None = None
    mask_path: Path | None = None
    mask_origin: MaskOrigin | None = None
    camera: CameraModel | None = None
    normals_truth: npt.NDArray[np.float32] | None = None
    cfa: str | None = None
    black_level: float = 0.0
    white_level: float = 1.0
    files: tuple[Path, ...] = ()
    ignored: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of every frame."""
        return self.frames[0].shape[0], self.frames[0].shape[1]

    @property
    def light_ids(self) -> tuple[str, ...]:
        """The lights that frames were taken under, each once, in order of the frames."""
        return tuple(dict.fromkeys(f.light_id for f in self.frames if f.role == "light"))
