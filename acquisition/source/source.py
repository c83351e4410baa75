"""Common form of all kinds of recordings for processing: frames, lights, mask, camera."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError
from acquisition.pixels.images import Image, read_image
from acquisition.pixels.plain_rows import PlainRows
from acquisition.plan.planned_shot import Role
from acquisition.values.camera_model import CameraModel
from acquisition.values.flat import Flat
from acquisition.values.lights import Lights
from acquisition.values.noise_model import NoiseModel
from acquisition.values.setup import Setup
from acquisition.values.transfer_curve import LINEAR, TransferCurve
from rig import MAX_PIXELS, Notice, pluralize, short_repr
from rig.arrays import Bool, Float32

Sample = TypeVar("Sample", bound=np.generic)
SourceKind = Literal["session", "diligent", "lp", "images"]
Reference = Literal["ambient", "dark"]
MaskOrigin = Literal["given", "folder", "recording", "alpha"]


@dataclass(frozen=True)
class Reduction:
    """A region of frames, and the number of pixels per axis that become one.

    Parameters
    ----------
    x, y
        Column and row of the region's first pixel in a frame.
    width, height
        Size of the region in pixels of a frame. Columns on the right and rows at the bottom that do
        not fill a block of ``factor x factor`` pixels are not used.
    factor
        Pixels per axis that are averaged, at least 1.
    """

    x: int
    y: int
    width: int
    height: int
    factor: int = 1

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the reduced image."""
        return self.height // self.factor, self.width // self.factor

    def cut(self, image: npt.NDArray[Sample]) -> npt.NDArray[Sample]:
        """Return the used part of an image ``(H, W, ...)`` of a frame's size, as a view."""
        height, width = self.size
        rows = slice(self.y, self.y + height * self.factor)
        return image[rows, self.x : self.x + width * self.factor]

    def blocks(self, image: npt.NDArray[Sample]) -> list[npt.NDArray[Sample]]:
        """Return the ``factor^2`` views that contain one pixel of each block."""
        part, step = self.cut(image), self.factor
        return [part[row::step, column::step] for row in range(step) for column in range(step)]

    def mean(self, image: Float32) -> Float32:
        """Return the average of each block, NaN if a sample of the block is NaN.

        Parameters
        ----------
        image
            ``(H, W)`` or ``(H, W, 3)`` linear values of a frame's size.

        Returns
        -------
        npt.NDArray[np.float32]
            Image of `size`; a copy.
        """
        first, *others = self.blocks(image)
        total = first.copy()
        for block in others:
            total += block
        return total if not others else np.divide(total, np.float32(1 + len(others)), out=total)

    def all(self, mask: Bool) -> Bool:
        """Return where all pixels of a block are True, ``(H, W)`` of `size`."""
        every: Bool = np.logical_and.reduce(self.blocks(mask))
        return every


@dataclass(frozen=True)
class ReadOptions:
    """What the caller of `read_source` states about the files.

    Parameters
    ----------
    mask_path
        Mask to use instead of that of the source.
    max_pixels
        Largest allowed number of pixels per image.
    transfer
        Transfer curve of the samples; None: as the files state.
    """

    mask_path: Path | None = None
    max_pixels: int = MAX_PIXELS
    transfer: TransferCurve | None = None


@dataclass(frozen=True, eq=False)
class Frame:
    """One image of a recording, read on request.

    Parameters
    ----------
    path
        Image file.
    light_id
        ``L07`` for LED 7 of a session; the stem of the file name for other sources.
    shape
        ``(H, W)`` or ``(H, W, 3)``, the same for all frames of a source.
    role
        ``light``, ``dark``, ``ambient`` or ``flat``.
    bracket
        Index of the exposure, from 0.
    exposure_us
        Exposure time, microseconds; None if not known.
    load
        Function that reads the pixels of files that `read_image` does not read.
    max_pixels
        Largest allowed number of pixels of the file.
    check_rows
        Function that checks a file whose rows can be read one by one and returns them, or None;
        None for files that must be read as a whole.
    gain_db
        Analogue gain, decibels; None if not known.
    mark_clipped
        Function that raises clipped samples to the white level; None if they have that value.
    exposure_sigma
        Relative standard deviation of `exposure_us`, where differing times are stated rounded.
    """

    path: Path
    light_id: str
    shape: tuple[int, ...]
    role: Role = "light"
    bracket: int = 0
    exposure_us: float | None = None
    load: Callable[[], Image] | None = field(default=None, repr=False)
    max_pixels: int = field(default=MAX_PIXELS, repr=False)
    check_rows: Callable[[], PlainRows | None] | None = field(default=None, repr=False)
    gain_db: float | None = None
    mark_clipped: Callable[[Image], Image] | None = field(default=None, repr=False)
    exposure_sigma: float = field(default=0.0, repr=False)

    __repr__ = short_repr

    def read(self) -> Image:
        """Return the pixels without subtracting the black level and without scaling.

        Clipped samples have the white level.

        Raises
        ------
        DataError
            As `read_stored`.
        """
        pixels = self.read_stored()
        return pixels if self.mark_clipped is None else self.mark_clipped(pixels)

    def read_stored(self) -> Image:
        """Return the pixels as stored.

        Raises
        ------
        DataError
            If the file has been removed, is damaged, or has another shape than the other frames.
        """
        if not self.path.exists():
            raise DataError(f"{self.path}: the file is missing: restore it")
        if self.load is None:
            pixels = read_image(self.path, max_pixels=self.max_pixels)
        else:
            pixels = self.load()
        if pixels.shape != self.shape:
            raise DataError(
                f"{self.path}: shape {pixels.shape}, but the other frames have {self.shape}: "
                "restore the file"
            )
        return pixels

    def read_finite(self) -> Image:
        """Return the pixels as `read` does.

        Raises
        ------
        DataError
            As `read`, or if samples are not finite.
        """
        pixels = self.read()
        if not np.issubdtype(pixels.dtype, np.integer) and not np.isfinite(pixels).all():
            raise DataError(
                f"{self.path}: contains values that are not finite: replace them, or leave the "
                "image out"
            )
        return pixels


@dataclass(frozen=True, eq=False)
class Source:
    """A recording of any kind, ready for reading its frames.

    Parameters
    ----------
    path
        Folder or file that the caller named.
    kind
        ``session``, ``diligent``, ``lp`` (images with an .lp) or ``images``.
    frames
        All frames that count, at least one; those of a folder of images in order of their numbers.
    lights
        One light for each of `light_ids`, in that order and with those ids; None if not known.
    mask
        ``(H, W)`` bool, True on the object; None if there is no mask.
    mask_path
        Image file from which `mask` was read; None without a mask or for ``alpha``.
    mask_origin
        Origin of the mask. ``given``: the caller named the file. ``recording``: the mask belongs
        to a session, an export, a DiLiGenT folder or an .lp file, and shows the object.
        ``folder``: the mask is in a plain folder of images, and may show a chrome sphere instead
        of an object. ``alpha``: the alpha channels of the images. None without a mask.
    not_object
        ``(H, W)`` bool, True where the images certainly show something else than the object, such
        as calibration spheres next to it; None if there is no such region.
    camera
        Camera model with the size of the images; None if not known.
    camera_nominal
        Whether `camera` is only that of the focal length in the metadata of the images; see
        `calibrated_camera`.
    normals_truth
        ``(H, W, 3)`` float32 true unit normals, 0 where not known; None without true normals.
    cfa
        Colour filter pattern of mosaic frames, row by row from the top left; None for other frames.
    black_level, white_level
        Grey values without light and at saturation, in the unit of the files. The white level of
        float images is infinite: no sample counts as saturated, and values are not limited.
    reduction
        Region and resolution at which the frames are used; None for complete frames. `size`,
        `mask`, `not_object`, `camera` and `normals_truth` are those of the reduced images. See
        `crop` and `downscale`.
    shifts_px
        By how much the object is further right and down in the images of lights, by their ids, in
        pixels of `size`: `calibration.linear_stack` moves these images back.
    simulated
        Whether the frames are from a simulated rig or camera, as far as the recording states it.
    setup
        Rig and camera with which it was recorded, as far as the recording states them; without
        `Setup.intrinsics`, see `source_setup`.
    recorded_utc
        Start of the recording; None if it is not known.
    noise
        The sensor, as far as the recording states it, at the gain of the recording; None if not
        known.
    transfer
        The transfer curve of the samples, which `Linearizer` applies: light relative to white from
        samples relative to white, after the black level.
    transfer_origin
        What determined `transfer`, for people: ``given`` by the caller, a file of ours, metadata,
        or the kind of the images.
    flat
        Response of lens and sensor at each pixel of the complete frames, by which
        `calibration.linear_stack` divides; None for no division. See `apply_flat`.
    files
        All files that were read or that `frames` read.
    ignored
        Names in the folder that were not used; always empty for a session.
    warnings
        One notice for each assumption that was made.
    """

    path: Path
    kind: SourceKind
    frames: tuple[Frame, ...]
    lights: Lights | None = None
    mask: Bool | None = None
    mask_path: Path | None = None
    mask_origin: MaskOrigin | None = None
    not_object: Bool | None = None
    camera: CameraModel | None = None
    camera_nominal: bool = False
    normals_truth: Float32 | None = None
    cfa: str | None = None
    black_level: float = 0.0
    white_level: float = 1.0
    reduction: Reduction | None = None
    shifts_px: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    simulated: bool = False
    setup: Setup = field(default_factory=Setup)
    recorded_utc: datetime | None = None
    noise: NoiseModel | None = None
    transfer: TransferCurve = LINEAR
    transfer_origin: str = ""
    flat: Flat | None = None
    files: tuple[Path, ...] = ()
    ignored: tuple[str, ...] = ()
    warnings: tuple[Notice, ...] = ()

    def __repr__(self) -> str:
        height, width = self.size
        parts = [str(self.path), self.kind, pluralize(len(self.frames), "frame")]
        parts[-1] += f" of {width} x {height} px"
        known = ("lights", "mask", "camera", "normals_truth")
        parts += [name for name in known if getattr(self, name) is not None]
        return f"Source({', '.join(parts)})"

    @property
    def calibrated_camera(self) -> CameraModel | None:
        """The camera; None also if it is only that of the metadata of the images."""
        return None if self.camera_nominal else self.camera

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the images: of every frame, or of the reduced ones."""
        if self.reduction is not None:
            return self.reduction.size
        return self.frames[0].shape[0], self.frames[0].shape[1]

    @property
    def light_ids(self) -> tuple[str, ...]:
        """Ids of the lights of all frames, each once, in the order of the frames."""
        return tuple(dict.fromkeys(f.light_id for f in self.frames if f.role == "light"))
