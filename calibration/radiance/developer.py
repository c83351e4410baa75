"""Conversion of the frames of one light to its linear image."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from acquisition import DataError, Frame, Source
from acquisition.source import Linearizer, RowReader, row_bands
from calibration._errors import EstimateError
from calibration.radiance.brackets import (
    BLOOMING_PX,
    BracketRatios,
    Law,
    bits,
    clear_of_white,
    grown,
    merge,
)
from calibration.radiance.image_form import Channel, ImageForm, divided
from calibration.radiance.references import References
from calibration.radiance.shifted_rows import Shift
from calibration.radiance.signal_noise import SignalNoise, signal_noise
from calibration.radiance.stack_noise import StackNoise
from rig import Notice
from rig.arrays import Bool, Float32, Float64, Intp, UInt8, UInt16

Pixels = UInt8 | UInt16 | Float32
Index = slice | Intp

# The frames of a light and its intensity in each colour.
Task = tuple[list[Frame], Float64]
_LEAST_GREY_VALUES = 100.0
# A bracket of at least this share of the exposure time replaces samples close to white.
_REPLACES = 1 / 16
_ALL = slice(None)


class Developer:
    """Converts the frames of one light to its linear image; may be used by several threads.

    Attributes
    ----------
    tasks
        The frames of each light and its intensity in each colour.
    shape
        N, H, W of the images, and 3 for images in colour.
    form
        Channel, region and resolution of the images.
    references
        What the dark and ambient frames show.

    Raises
    ------
    DataError
        If no frame has a light, black and white level contradict each other, or an image has no
        valid exposure time although other images have one.
    """

    def __init__(self, source: Source, channel: Channel, reader: RowReader | None = None) -> None:
        lit = [frame for frame in source.frames if frame.role == "light"]
        if not lit:
            raise DataError(f"{source.path}: no image with a light")
        if not source.white_level > source.black_level >= 0:
            raise DataError(
                f"{source.path}: the white level of {source.white_level} must be above the black "
                f"level of {source.black_level}, which must not be negative"
            )
        self._source = source
        self.form = ImageForm(source, channel)
        exposures = [frame.exposure_us for frame in lit]
        known = [exposure for exposure in exposures if exposure is not None]
        if known and (len(known) < len(lit) or min(known) <= 0):
            path = next(f.path for f in lit if f.exposure_us is None or f.exposure_us <= 0)
            raise DataError(
                f"{path}: no valid exposure time, although other images have one: add it"
            )
        self._longest = max(known, default=1.0)
        self._linear = Linearizer(source, reader)
        self._response = None if source.flat is None else source.flat.response
        self._noise = signal_noise(source, self._linear)
        white = None if self._noise is None else self._noise.of_frame
        self._clear_of_white = clear_of_white(white)
        self.references = References(source, self._linear, sorted(set(known)))
        self._ratios = BracketRatios()
        self.shape = (len(source.light_ids), *source.size, *((3,) if channel == "rgb" else ()))
        lights = source.lights
        self.tasks: list[Task] = [
            (
                [frame for frame in lit if frame.light_id == name],
                np.ones(3)
                if lights is None or lights.intensities is None
                else lights.intensities[i],
            )
            for i, name in enumerate(source.light_ids)
        ]
        self._shifts = {
            i: Shift(*source.shifts_px[name])
            for i, name in enumerate(source.light_ids)
            if name in source.shifts_px
        }
        if self._shifts and self.form.pattern is not None:
            raise DataError(
                f"{source.path}: the sites of a mosaic cannot be moved by parts of a pixel: use "
                "another channel, or do not align the images"
            )

    @property
    def notices(self) -> tuple[Notice, ...]:
        """What was noted about references, hot pixels and brackets so far."""
        return (*self.references.notices, *self._ratios.notices)

    def used(self, rows: slice) -> UInt8 | None:
        """Return an array for the brackets in use at some rows, if the noise depends on them."""
        most = max(len(_brackets(frames)) for frames, _ in self.tasks)
        if self._noise is None or not self.form.independent or not 1 < most <= 8:
            return None
        width_and_colours = self.tasks[0][0][0].shape[1:]
        return np.zeros((len(self.tasks), rows.stop - rows.start, *width_and_colours), np.uint8)

    def noise(self, used: UInt8 | None) -> StackNoise | None:
        """Return the law of the noise of the images; None if it is unknown."""
        if self._noise is None:
            return None
        groups = [_brackets(frames) for frames, _ in self.tasks]
        shape = (len(groups), max(map(len, groups)))
        slope, floor = np.zeros(shape), np.full(shape, np.inf)
        limit = np.full(shape, np.inf)
        for i, brackets in enumerate(groups):
            for b, repeats in enumerate(brackets):
                law = self._law(self._noise, repeats)
                averaged = self._shifts[i].noise if i in self._shifts else 1.0
                slope[i, b], floor[i, b] = averaged * law.slope, averaged * law.floor
                if b < len(brackets) - 1:
                    level, _ = self._linear.reference_level(repeats[0].exposure_us)
                    clear = self._replaced(repeats, brackets[b + 1 :])
                    highest = self._clear_of_white if clear else 1.0
                    limit[i, b] = (highest - level) / self._share(repeats[0])
        intensities = np.array([intensity for _, intensity in self.tasks])
        return StackNoise(
            slope,
            floor,
            limit,
            intensities,
            self.form.site_factor(),
            self.form.colour(self.tasks[0][0][0]),
            self._noise.origin,
            used,
            self.form.pattern,
            self.form.response(),
        )

    def check_usable(self, images: Sequence[np.float32]) -> None:
        """Refuse images that show nothing.

        Parameters
        ----------
        images
            The brightest sample of each, or of parts of them; NaN if all are saturated.

        Raises
        ------
        EstimateError
            If all samples are saturated or black.
        """
        path, count = self._source.path, len(self.tasks)
        every = "the image" if count == 1 else f"all {count} images"
        # fmax skips images without any sample; max could return their NaN.
        brightest = np.fmax.reduce(images)
        if np.isnan(brightest):
            raise EstimateError(
                f"{path}: every sample of {every} is saturated: record with a shorter exposure time"
            )
        # Rounding and an inaccurate black level leave up to two grey values in a dark image.
        span = self._source.white_level - self._source.black_level
        least = float(self._source.transfer.light(2 / span)) if span >= _LEAST_GREY_VALUES else 0.0
        if not brightest > least and self.references.level > least:
            raise EstimateError(
                f"{path}: the dark or ambient frames are as bright as {every}: check "
                "which frames are dark, and that the LEDs were off"
            )
        if not brightest > least:
            raise EstimateError(
                f"{path}: {every} {'is' if count == 1 else 'are'} black or "
                "saturated: check the lights and the exposure"
            )

    def _law(self, noise: SignalNoise, repeats: list[Frame]) -> Law:
        """Return the law of the mean of repeats, in units of radiance."""
        level, references = self._linear.reference_level(repeats[0].exposure_us)
        return noise.law(self._share(repeats[0]), len(repeats), level, references)

    def _share(self, frame: Frame) -> float:
        """Return the exposure time relative to the longest."""
        return (frame.exposure_us or self._longest) / self._longest

    def __call__(
        self,
        index: int,
        rows: slice | None = None,
        out: Float32 | None = None,
        used: UInt8 | None = None,
    ) -> Float32:
        """Return rows of the merged image of a light, ``(H, W)`` or ``(H, W, 3)``.

        The default is all rows. They are written to `out`. Bit b of `used`, whose rows are the same
        ones of the frames, says whether bracket b counts at a sample.
        """
        wanted = slice(0, self.shape[1]) if rows is None else rows
        shift = self._shifts.get(index)
        if shift is None:
            return self._made(index, wanted, out, used)
        around = shift.rows(wanted, self.shape[1])
        used_around = None
        if used is not None:
            used_around = np.zeros((around.stop - around.start, *used.shape[1:]), np.uint8)
        image = self._made(index, around, None, used_around)
        made = shift.moved(image, around.start, wanted)
        if used is not None and used_around is not None:
            used[...] = shift.whole(used_around, around.start, wanted)
        if out is None:
            return made
        out[...] = made
        return out

    def _made(self, index: int, wanted: slice, out: Float32 | None, used: UInt8 | None) -> Float32:
        """Return rows of the merged image of a light where they were recorded."""
        frames, intensity = self.tasks[index]
        if out is None:
            out = np.zeros((wanted.stop - wanted.start, *self.shape[2:]), np.float32)
        if len(frames) == 1 and self.form.independent:
            if used is not None:
                used[...] = 1
            # Its pixels are independent.
            pixels, top = self._linear.pixels(frames[0], wanted), wanted.start
            for band in row_bands(len(pixels)):
                radiance = self._alone(frames[0], pixels, (band, _ALL), top)
                out[band] = self.form.image(radiance, intensity, frames[0], top + band.start)
            return out
        window, cut = self.form.window(wanted)
        merged = self._merged(_brackets(frames), window, used)
        out[...] = self.form.image(merged, intensity, frames[0], window.start, cut)
        return out

    def _alone(
        self, frame: Frame, pixels: Pixels, part: tuple[Index, Index], top: int = 0
    ) -> Float32:
        """Return the radiance of a part of the only frame of a light."""
        radiance, unusable = self._linear.part(frame, pixels, part, top)
        share = np.float32(self._share(frame))
        if share != 1:
            radiance /= share
        if self._response is not None:
            radiance /= self._response[top:][part]
        radiance[unusable] = np.nan
        return radiance

    def raw(self, index: int) -> Pixels | None:
        """Read the pixels of a light with one frame of grey pixels, which are independent.

        None for other lights. Raises as `acquisition.source.Linearizer.signal`.
        """
        frames, _ = self.tasks[index]
        single = len(frames) == 1 and len(frames[0].shape) == 2 and index not in self._shifts
        if single and self._source.cfa is None and self._source.reduction is None:
            return self._linear.pixels(frames[0])
        return None

    def part(self, index: int, pixels: Pixels, part: tuple[Index, Index]) -> Float32:
        """Return the linear values of a part of a frame that `raw` read, as in its image."""
        (frame,), intensity = self.tasks[index]
        return divided(self._alone(frame, pixels, part), intensity)

    def _merged(self, brackets: list[list[Frame]], rows: slice, used: UInt8 | None) -> Float32:
        """Return the radiance of a light from all its frames, NaN where none is usable."""
        if len(brackets) > 1 and brackets[0][0].exposure_us is None:
            raise DataError(
                f"{brackets[1][0].path}: brackets can be merged only if the exposure times are "
                "known: add them"
            )
        # Saturated pixels matter beyond the rows.
        beyond = BLOOMING_PX if len(brackets) > 1 else 0
        height = brackets[0][0].shape[0]
        window = slice(max(rows.start - beyond, 0), min(rows.stop + beyond, height))
        inner = slice(rows.start - window.start, rows.stop - window.start)
        samples = [[self._linear.pixels(frame, window) for frame in of_one] for of_one in brackets]
        usable = [
            self._usable(repeats, samples[b], brackets[b + 1 :], window)[inner]
            for b, repeats in enumerate(brackets)
        ]
        samples = [[pixels[inner] for pixels in repeats] for repeats in samples]
        if used is not None:
            used[...] = bits(usable)
        first_of_each = [repeats[0] for repeats in brackets]
        shares = [self._share(frame) for frame in first_of_each]
        exposure = [sum(map(self._share, repeats)) for repeats in brackets]
        noise = self._noise
        laws = None if noise is None else [self._law(noise, repeats) for repeats in brackets]
        out: Float32 = np.zeros(samples[0][0].shape, np.float32)
        for band in row_bands(len(out)):
            radiance = [
                self._mean(repeats, of_one, band, rows.start)
                for repeats, of_one in zip(brackets, samples, strict=True)
            ]
            count = [mask[band] for mask in usable]
            # Not divided by the flat yet: noise and brackets depend on the light at the sensor.
            out[band] = merge(radiance, count, exposure, laws)
            top = rows.start + band.start
            self._ratios.add(first_of_each, shares, radiance, count, out[band], top)
        if self._response is not None:
            out /= self._response[rows]
        return out

    def _usable(
        self, repeats: list[Frame], samples: list[Pixels], shorter: list[list[Frame]], rows: slice
    ) -> Bool:
        """Return the samples that count in some rows of the frames.

        If a shorter bracket replaces this one, these are neither close to white, nor near samples
        that are, nor hot. Otherwise they are those that are not saturated: a much shorter exposure
        shows less than a sample next to white, or a hot pixel less its dark signal.
        """
        black, white = self._source.black_level, self._source.white_level
        hot = self.references.hot_at(repeats[0].exposure_us)
        replaced = self._replaced(repeats, shorter)
        limit = white
        if replaced and np.isfinite(white):
            limit = min(black + (white - black) * self._clear_of_white, white)
        near: Bool = np.zeros(samples[0].shape, np.bool_)
        for of_one in samples:
            # Integers are compared with integers, without a copy in double precision.
            near |= of_one >= (limit if of_one.dtype.kind == "f" else math.ceil(limit))
        if not replaced:
            return ~near
        if hot is None:
            return ~grown(near)
        # A hot pixel says nothing about the light around it.
        return ~(grown(near & ~hot[rows]) | near | hot[rows])

    def _replaced(self, repeats: list[Frame], shorter: list[list[Frame]]) -> bool:
        """Return whether one of the shorter brackets is long enough to replace a bracket."""
        least = _REPLACES * self._share(repeats[0])
        return any(self._share(other[0]) >= least for other in shorter)

    def _mean(self, repeats: list[Frame], samples: list[Pixels], band: slice, top: int) -> Float32:
        """Return the radiance of some rows, the mean of repeats."""
        total = self._linear.part(repeats[0], samples[0], (band, _ALL), top)[0]
        for frame, of_one in zip(repeats[1:], samples[1:], strict=True):
            total += self._linear.part(frame, of_one, (band, _ALL), top)[0]
        total /= np.float32(sum(self._share(frame) for frame in repeats))
        return total


def _brackets(frames: list[Frame]) -> list[list[Frame]]:
    """Return the frames of a light by bracket, the longest exposure first.

    Exposure times that a camera reports may differ slightly between repeats.
    """
    brackets: dict[int, list[Frame]] = {}
    for frame in sorted(frames, key=lambda frame: frame.exposure_us or 0.0, reverse=True):
        brackets.setdefault(frame.bracket, []).append(frame)
    return list(brackets.values())


def brightest_sample(image: Float32) -> np.float32:
    """Return the largest sample that is not NaN; NaN without any."""
    return np.float32(np.fmax.reduce(image, axis=None))
