"""Conversion of the frames of one light to its linear image."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from acquisition import DataError, Frame, Linearizer, Source, same_exposure
from calibration._errors import EstimateError
from calibration._radiance.demosaic import demosaic
from rig import Notice

FloatImage = npt.NDArray[np.float32]
Array = npt.NDArray[np.float64]
Pixels = npt.NDArray[np.uint8] | npt.NDArray[np.uint16] | npt.NDArray[np.float32]
Index = slice | npt.NDArray[np.intp]

# ITU-R BT.601 luma, as in the published results on DiLiGenT.
_LUMA = np.array([0.2989, 0.587, 0.114], np.float32)
_THREADS = 4
# Bytes of the linear images that are computed at the same time; each needs several times as much.
_AT_ONCE = 200_000_000
_LEAST_GREY_VALUES = 100.0


def lit_frames(source: Source) -> list[Frame]:
    """Return the frames with a light.

    Raises
    ------
    DataError
        If no frame has a light, or black and white level contradict each other.
    """
    lit = [frame for frame in source.frames if frame.role == "light"]
    if not lit:
        raise DataError(f"{source.path}: no image with a light")
    if not source.white_level > source.black_level >= 0:
        raise DataError(
            f"{source.path}: the white level of {source.white_level} must be above the black level "
            f"of {source.black_level}, which must not be negative"
        )
    return lit


def threads_for(image_bytes: int) -> int:
    """Return the number of threads for images whose linear values have this size."""
    return max(1, min(_THREADS, _AT_ONCE // image_bytes))


class Developer:
    """Callable that converts the frames of one light to its linear image."""

    def __init__(self, source: Source, lit: list[Frame], channel: Literal["gray", "rgb"]) -> None:
        self._source = source
        self._channel = channel
        exposures = [frame.exposure_us for frame in lit]
        known = [exposure for exposure in exposures if exposure is not None]
        if known and (len(known) < len(lit) or min(known) <= 0):
            path = next(f.path for f in lit if f.exposure_us is None or f.exposure_us <= 0)
            raise DataError(
                f"{path}: no valid exposure time, although other images have one: add it"
            )
        self._longest = max(known, default=1.0)
        self._linear = Linearizer(source)
        self.warnings: list[Notice] = []
        unlit = any(frame.role in ("dark", "ambient") for frame in source.frames)
        if unlit and not known and self._linear.reference(None) is None:
            text = "dark and ambient frames were not used: the images have no exposure times"
            self.warnings.append(Notice("dark-frames-unused", text))
        last_us = 0.0
        for exposure_us in sorted(set(known)) if unlit else ():
            if last_us and same_exposure(exposure_us, last_us):
                continue
            last_us = exposure_us
            if self._linear.reference(exposure_us) is None:
                text = (
                    f"no dark or ambient frame with an exposure of {exposure_us:g} us: only the "
                    "black level was subtracted"
                )
                self.warnings.append(Notice("dark-frames-missing", text))

    def __call__(
        self,
        frames: list[Frame],
        intensity: npt.NDArray[np.float64],
        out: FloatImage | None = None,
    ) -> FloatImage:
        """Return the merged image of one light, ``(H, W)`` or ``(H, W, 3)``, written to `out`."""
        if len(frames) == 1 and self._source.cfa is None and self._source.reduction is None:
            return self._in_bands(frames[0], intensity, out)
        # Group by bracket: exposure times reported by a camera may differ slightly between repeats.
        brackets: dict[int, list[Frame]] = {}
        for frame in sorted(frames, key=lambda frame: frame.exposure_us or 0.0, reverse=True):
            brackets.setdefault(frame.bracket, []).append(frame)
        longest, *shorter = brackets.values()
        merged = self._mean(longest)
        for repeats in shorter:
            if not np.isnan(merged).any():
                break
            merged = np.where(np.isnan(merged), self._mean(repeats), merged)
        image = self._colour(merged, intensity, frames[0])
        if out is None:
            return image
        out[...] = image
        return out

    def _in_bands(
        self, frame: Frame, intensity: npt.NDArray[np.float64], out: FloatImage | None
    ) -> FloatImage:
        """Return the image of a light with one frame, whose pixels are independent."""
        for rows, signal, saturated in self._linear.bands(frame):
            image = self._colour(self._exposed(frame, signal, saturated), intensity, frame)
            if out is None:
                out = np.zeros((frame.shape[0], *image.shape[1:]), np.float32)
            out[rows] = image
        if out is None:
            raise AssertionError("a frame has rows")
        return out

    def keeps_raw(self, frames: list[Frame]) -> bool:
        """Return whether a light has one frame of grey pixels, which are independent."""
        single = len(frames) == 1 and len(frames[0].shape) == 2
        return single and self._source.cfa is None and self._source.reduction is None

    def raw(self, frame: Frame) -> Pixels:
        """Read the pixels of a frame, for `part`; raises as `acquisition.Linearizer.signal`."""
        return self._linear.pixels(frame)

    def part(
        self, frame: Frame, pixels: Pixels, intensity: Array, part: tuple[Index, Index]
    ) -> FloatImage:
        """Return the linear values of a part of a frame that `keeps_raw`, as in its image."""
        signal, saturated = self._linear.part(frame, pixels, part)
        return self._divided(self._exposed(frame, signal, saturated), intensity)

    def _mean(self, repeats: list[Frame]) -> FloatImage:
        image = self._radiance(repeats[0])
        for frame in repeats[1:]:
            image += self._radiance(frame)
        image /= np.float32(len(repeats))
        return image

    def _radiance(self, frame: Frame) -> FloatImage:
        return self._exposed(frame, *self._linear.signal_and_saturation(frame))

    def _exposed(
        self, frame: Frame, radiance: FloatImage, saturated: npt.NDArray[np.bool_]
    ) -> FloatImage:
        share = np.float32((frame.exposure_us or self._longest) / self._longest)
        if share != 1:
            radiance /= share
        radiance[saturated] = np.nan
        return radiance

    def _colour(
        self, image: FloatImage, intensity: npt.NDArray[np.float64], frame: Frame
    ) -> FloatImage:
        if image.ndim == 2 and self._source.cfa is not None:
            image = demosaic(image, self._source.cfa)
        if self._source.reduction is not None:
            image = self._source.reduction.mean(image)
        if image.ndim == 2:
            if self._channel == "rgb":
                raise DataError(f"{frame.path}: the image has one channel: use gray, not rgb")
            return self._divided(image, intensity)
        image /= intensity.astype(np.float32)
        return image if self._channel == "rgb" else luma(image)

    @staticmethod
    def _divided(image: FloatImage, intensity: Array) -> FloatImage:
        strength = np.float32(intensity.mean())
        if strength != 1:
            image /= strength
        return image


def luma(colour: FloatImage) -> FloatImage:
    """Return the gray values ``.2989 R + .587 G + .114 B`` of linear colours ``(..., 3)``.

    Examples
    --------
    >>> import numpy as np
    >>> from calibration import luma
    >>> luma(np.array([[1, 0, 0], [1, 1, 1]], np.float32)).round(4)
    array([0.2989, 0.9999], dtype=float32)
    """
    return np.asarray(colour @ _LUMA, np.float32)


def frames_of_lights(source: Source, lit: list[Frame]) -> list[tuple[list[Frame], Array]]:
    """Return the frames of each light and its intensity in each colour."""
    lights = source.lights
    return [
        (
            [frame for frame in lit if frame.light_id == name],
            np.ones(3) if lights is None or lights.intensities is None else lights.intensities[i],
        )
        for i, name in enumerate(source.light_ids)
    ]


def brightest_sample(image: FloatImage) -> np.float32:
    """Return the largest sample that is not NaN; NaN without any."""
    return np.float32(np.fmax.reduce(image, axis=None))


def check_usable(images: list[np.float32], ids: tuple[str, ...], source: Source) -> None:
    # fmax skips images without any sample; max could return their NaN.
    brightest = np.fmax.reduce(images)
    if np.isnan(brightest):
        raise EstimateError(
            f"{source.path}: every sample of {_all(len(ids))} is saturated: "
            "record with a shorter exposure time"
        )
    # Rounding and an inaccurate black level leave up to two grey values in a dark image.
    span = source.white_level - source.black_level
    least = float(source.transfer.light(2 / span)) if span >= _LEAST_GREY_VALUES else 0.0
    if not brightest > least:
        raise EstimateError(
            f"{source.path}: {_all(len(ids))} {'is' if len(ids) == 1 else 'are'} black: check the "
            "lights and the exposure"
        )


def _all(images: int) -> str:
    return "the image" if images == 1 else f"all {images} images"
