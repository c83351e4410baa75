"""Facts that differ between the images of a series: what is applied, and what is stated."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from acquisition._errors import DataError
from acquisition.pixels.stated_facts import ImageFacts
from acquisition.source.linear_frames import same_exposure
from acquisition.source.source import Frame, Reference
from acquisition.values.light_errors import LightErrors
from acquisition.values.lights import Lights
from acquisition.values.transfer_curve import LINEAR, TransferCurve
from rig import Notice, pluralize

# Exposure times in thirds of a stop, as ISO 2721 marks them; cameras expose for powers of 2^(1/3).
_MARKINGS: Final = (
    8, 10, 13, 15, 20, 25, 30, 40, 50, 60, 80, 100, 125, 160, 200, 250, 320, 400, 500, 640, 800,
    1000, 1250, 1600, 2000, 2500, 3200, 4000, 5000, 6400, 8000, 0.3, 0.4, 0.5, 0.6, 0.8, 1, 1.3,
    1.6, 2, 2.5, 3, 3.2, 4, 5, 6,
)  # fmt: skip
_WHITE_8_BIT = 255
# At the beginning of a name, or as its last word (``sample_raw_ambient``).
_NAME: Final = re.compile(r"(?:^|.*[-_. ](?=[a-z]+[-_. ]?\d*$))(dark|ambient)", re.IGNORECASE)


@dataclass(frozen=True)
class ExposureTimes:
    """Exposure times of the images of a series, as they are applied.

    Parameters
    ----------
    us
        Time of each image, microseconds; None if no image states one.
    sigma
        Relative standard deviation of each time, for the rounding of the statements; 0 if all
        times are equal.
    notices
        What is applied.
    """

    us: tuple[float | None, ...]
    sigma: tuple[float, ...]
    notices: tuple[Notice, ...] = ()


def exposure_times(images: Sequence[ImageFacts], where: Path) -> ExposureTimes:
    """Return the exposure times of the images with light of a series.

    The times are those of ShutterSpeedValue if all images state it, else of ExposureTime. If some
    images state none, those of the others must be equal, and all count as equal.

    Raises
    ------
    DataError
        If an image states no time, although the times of others differ.
    """
    fine = all(image.shot.shutter_us for image in images)
    tag = "ShutterSpeedValue" if fine else "ExposureTime"
    stated = [
        image.shot.shutter_us if fine else image.shot.exposure_us or image.shot.shutter_us
        for image in images
    ]
    known = [time for time in stated if time is not None]
    nothing = (0.0,) * len(images)
    if not known:
        return ExposureTimes(tuple(stated), nothing)
    shortest, longest = min(known), max(known)
    equal = same_exposure(shortest, longest)
    missing = [image.path for image, time in zip(images, stated, strict=True) if time is None]
    if missing and not equal:
        raise DataError(
            f"{missing[0]}: states no exposure time, but those of other images differ "
            f"({_seconds(shortest)} to {_seconds(longest)}): add its ExposureTime"
        )
    if missing:
        text = (
            f"{pluralize(len(missing), 'image states', 'images state')} no exposure time, the "
            f"first is {missing[0].name}: taken as {_seconds(known[0])}, as all others state"
        )
        notice = Notice("exposure-times-assumed", text, str(where))
        return ExposureTimes(tuple(time or known[0] for time in stated), nothing, (notice,))
    if equal:
        return ExposureTimes((known[0],) * len(images), nothing)
    text = (
        f"exposure times of {_seconds(shortest)} to {_seconds(longest)} ({tag}) are applied to "
        f"{pluralize(len(images), 'image')}"
    )
    sigma = nothing if fine else _rounding_errors(known)
    if any(sigma):
        text += (
            "; cameras round the times that they state, here by "
            f"{max(sigma):.1%} (standard deviation), which is part of the errors of the lights"
        )
    notice = Notice("exposure-times-applied", text, str(where), "info")
    return ExposureTimes(tuple(stated), sigma, (notice,))


def reference_times(
    references: Sequence[ImageFacts], times: ExposureTimes
) -> tuple[tuple[float | None, ...], bool]:
    """Return the exposure times of dark and ambient frames, and whether one was assumed.

    A frame that states none has that of the images, if theirs are equal. If the images state none,
    all count as equally long.
    """
    stated = [facts.shot.time_us for facts in references]
    if None in times.us:
        return (None,) * len(references), True
    common = times.us[0] if len(set(times.us)) == 1 else None
    return tuple(time or common for time in stated), common is not None and None in stated


def orientation_notices(first: ImageFacts, where: str) -> tuple[Notice, ...]:
    """Return the notice of images that a viewer turns; nothing if it does not."""
    if first.shot.orientation in (1, None):
        return ()
    text = (
        f"the images have the Orientation tag {first.shot.orientation}, by which viewers turn "
        "them: the stored pixels are used, not turned, so lights and masks must fit these"
    )
    return (Notice("orientation-tag", text, where, "info"),)


def part_notices(first: ImageFacts, where: str) -> tuple[Notice, ...]:
    """Return the notice of files that hold further images; nothing if they hold one."""
    if first.parts == 1:
        return ()
    text = f"the images are files of {first.parts} parts ({first.path.name}): the first is read"
    return (Notice("parts-not-read", text, where),)


def with_time_errors(lights: Lights, frames: Sequence[Frame]) -> Lights:
    """Return lights whose errors of intensity contain those of the exposure times of their frames.

    Parameters
    ----------
    lights
        Lights with the ids of the frames.
    frames
        Frames with light, each of another light if their times have errors.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from acquisition import Frame, Lights
    >>> from acquisition.source import with_time_errors
    >>> lights = Lights(np.array([[0.0, 0, 1]]), ids=("a",))
    >>> frames = [Frame(Path("a.png"), "a", (4, 5), exposure_us=2e4, exposure_sigma=0.04)]
    >>> with_time_errors(lights, frames).errors.intensity_std
    array([[0.04, 0.04, 0.04]])
    """
    of_light = {frame.light_id: frame.exposure_sigma for frame in frames if frame.role == "light"}
    sigma = np.array([of_light.get(name, 0.0) for name in lights.ids])
    if not sigma.any():
        return lights
    errors = lights.errors or LightErrors()
    own = 0.0 if errors.intensity_std is None else np.nan_to_num(errors.intensity_std)
    strength = np.asarray(lights.intensities, np.float64) * sigma[:, None]
    return replace(lights, errors=replace(errors, intensity_std=np.hypot(own, strength)))


def _rounding_errors(times_us: Sequence[float]) -> tuple[float, ...]:
    """Return the relative standard deviation of each stated time against the most frequent one.

    The error of that one is shared by all images, and so is part of the albedo.
    """
    usual = Counter(times_us).most_common(1)[0][0]
    return tuple(
        0.0 if time == usual else math.hypot(_rounding(time), _rounding(usual)) for time in times_us
    )


def _rounding(exposure_us: float) -> float:
    """Return the standard deviation of a stated time relative to the true one.

    Cameras with a shutter round powers of 2^(1/3) s to markings, such as 1/64 to 1/60; for others
    these times are exact. A time that is a marking is uncertain evenly between the two.
    """
    seconds = exposure_us / 1e6
    value = 1 / seconds if seconds < 0.29 else seconds
    if not any(abs(value / marking - 1) < 1e-4 for marking in _MARKINGS):
        return 0.0
    exact = 2 ** (round(3 * math.log2(seconds)) / 3)
    return abs(seconds / exact - 1) / math.sqrt(3)


def _seconds(time_us: float) -> str:
    seconds = time_us / 1e6
    return f"1/{1 / seconds:.3g} s" if seconds < 0.3 else f"{seconds:.3g} s"


def raw_preferred_notice(count: int | None, where: str) -> Notice:
    """Return the notice that camera RAW is used and the other images are not.

    ``count`` is their number, None if more may follow.
    """
    text = "the camera stores RAW and other images of the same exposures: the RAW files are used"
    if count is not None:
        others = pluralize(count, "other image is", "other images are")
        text += f", the {others} not"
    return Notice("raw-preferred", text, where, "info")


def transfer_notices(
    curve: TransferCurve, origin: str, white_level: float, where: str
) -> tuple[Notice, ...]:
    """Return a notice about a curve that was chosen, or nothing if there was hardly a choice.

    Samples of more than 8 bits are linear unless metadata say otherwise: that needs no notice. A
    colour profile is always mentioned, also one that cannot be used, and so is an unknown transfer.
    """
    mentioned = "profile" in origin or "unknown" in origin
    if curve == LINEAR and white_level > _WHITE_8_BIT and not mentioned:
        return ()
    text = f"the samples are read as {curve.name} ({origin})"
    return (Notice("transfer-curve", text, where, "info"),)


def split_references(
    images: Sequence[Path], listed: int = 0
) -> tuple[list[Path], dict[Path, Reference]]:
    """Return the images that are no dark or ambient frames, and those that are, with their roles.

    Names that begin with ``dark`` or ``ambient``, or whose last word does, are such frames. If more
    than half of the images have such names, they belong to an object, and none is.
    ``listed`` is the number of other images that a list of lights names.
    """
    found: dict[Path, Reference] = {}
    for path in images:
        match = _NAME.match(path.stem)
        if match is not None:
            found[path] = "dark" if match[1].casefold() == "dark" else "ambient"
    if listed + len(images) - len(found) < max(1, len(found)):
        return list(images), {}
    return [path for path in images if path not in found], found


def reference_notices(
    folder: Path, references: Mapping[Path, Reference], assumed: bool
) -> tuple[Notice, ...]:
    """Return the notice that names the roles of reference frames; none without any.

    ``assumed`` is whether one has the exposure time of the images because it states none.
    """
    if not references:
        return ()
    roles: tuple[Reference, ...] = ("dark", "ambient")
    counts = [(role, sum(other == role for other in references.values())) for role in roles]
    found = " and ".join(pluralize(count, f"{role} frame") for role, count in counts if count)
    text = f"{found}, by name ({next(iter(references)).name})"
    if assumed:
        text += ", with the exposure time of the images"
    return (Notice("reference-frames-found", text, str(folder), "info"),)
