"""Options that several commands share, and their bounds."""

from __future__ import annotations

import math
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar, get_type_hints

from cyclopts import CoercionError, Parameter, Token
from cyclopts.validators import Number

import acquisition
import processing
from rig import MAX_PIXELS
from rig.processes import memory_size
from sgp.cli.exit import UsageError

T = TypeVar("T")


def _converter(read: Callable[[str], T]) -> Callable[[object, Sequence[Token]], T]:
    """Return a converter for the parser from a function of text that raises `ValueError`."""

    def convert(kind: object, tokens: Sequence[Token]) -> T:
        try:
            return read(tokens[0].value)
        except ValueError as error:
            raise CoercionError(msg=str(error), token=tokens[0]) from error

    return convert


@_converter
def _whole(text: str) -> int:
    """Read a whole number; the parser's own conversion would round 1.5."""
    if not re.fullmatch(r"\s*[-+]?[0-9]{1,30}\s*", text):
        raise ValueError(f"{_short(text)} is not a whole number")
    return int(text)


@_converter
def _led(text: str) -> int:
    """Read the number of an LED, as it is in the names of frames: 7, 07 or L07."""
    found = re.fullmatch(r"\s*[Ll]?([0-9]{1,30})\s*", text)
    if found is None:
        raise ValueError(f"{_short(text)} is not the number of an LED, such as 7 or L07")
    return int(found[1])


def _finite(text: str) -> float:
    """Read a finite number: NaN would pass every bound, and infinity is not a valid quantity."""
    try:
        value = float(text)
    except ValueError as error:
        raise ValueError(f"{_short(text)} is not a number") from error
    if not math.isfinite(value):
        raise ValueError(f"{_short(text)} is not a finite number")
    return value


_real = _converter(_finite)


@_converter
def _gamma(text: str) -> str:
    """Check the text of a transfer curve before anything is read; see `transfer_of`."""
    if text.lower() in _CURVES or transfer_files(text):
        return text
    try:
        value = _finite(text)
    except ValueError as error:
        others = ", auto, srgb, linear or a file" if "not a number" in str(error) else ""
        raise ValueError(f"{error}{others}") from error
    if not _LEAST_GAMMA <= value <= _MOST_GAMMA:
        raise ValueError(f"{_short(text)} is not within {_LEAST_GAMMA:g} to {_MOST_GAMMA:g}")
    return text


@_converter
def _light_distance(text: str) -> float | str:
    """Read a distance in mm, or the word ``estimate``."""
    if text.lower() == "estimate":
        return "estimate"
    value = _finite(text)
    if not 0 < value <= _MOST_DISTANCE:
        raise ValueError(f"{_short(text)} is not above 0 and at most {_MOST_DISTANCE:g}")
    return value


def _names(kind: object, tokens: Sequence[Token]) -> tuple[str, ...]:
    """Read names separated by commas; the option may be given several times."""
    names = tuple(part.strip() for token in tokens for part in token.value.split(","))
    if not all(names):
        text = "a name is empty: give names separated by commas"
        raise CoercionError(msg=text, token=tokens[0])
    return names


@_converter
def _region(text: str) -> tuple[int, int, int, int]:
    """Read ``x,y,w,h`` in whole pixels."""
    parts = text.split(",")
    wrong = next((part for part in parts if not re.fullmatch(_PIXELS, part)), None)
    if wrong is not None or len(parts) != 4:
        whole = f"{_short(text)} is not a number for each of x,y,w,h"
        shown = whole if wrong is None else f"{_short(wrong)} is not a whole number"
        raise ValueError(f"{shown}: give pixels, such as 100,80,640,480")
    x, y, width, height = map(int, parts)
    return x, y, width, height


@_converter
def _bytes(text: str) -> int:
    """Read a size of memory such as 3G."""
    try:
        return memory_size(text)
    except ValueError as error:
        raise ValueError(f"{_short(text)} {error}") from error


def _short(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


# Longest part of a command line that a message quotes, in characters.
_LONGEST = 40
_PIXELS = r"\s*[-+]?[0-9]{1,7}\s*"
_CURVES = ("auto", "srgb", "linear")
_MOST_DISTANCE = 1e6
_LEAST_GAMMA, _MOST_GAMMA = 0.1, 10.0


@_converter
def _rig(text: str) -> Path:
    """Read the name of a rig or a path; ``./dome`` stays a path, which Path("./dome") forgets."""
    path = Path(text)
    return path.absolute() if str(path) == path.name != text else path


# What an option for lights gives for those of the rig file.
RIG_LIGHTS = Path("rig")
RigOption = Annotated[Path | None, Parameter(converter=_rig)]
# Direction of the green channel of a normal map.
Green = Literal["up", "down"]
_INPUT = object()
# Files or folders that must exist when the command starts.
Input = Annotated[Path, _INPUT]
OptionalInput = Annotated[Path | None, _INPUT]
_LIGHTS = object()
# A file with lights, or the word ``rig`` for those of the rig file.
LightsInput = Annotated[Path, _LIGHTS]
OptionalLights = Annotated[Path | None, _LIGHTS]
Inputs = Annotated[tuple[Path, ...], _INPUT]
Whole = Annotated[int, Parameter(converter=_whole)]
LedNumber = Annotated[int, Parameter(converter=_led)]
Real = Annotated[float, Parameter(converter=_real)]
# Bytes, such as 3G.
Memory = Annotated[int, Parameter(converter=_bytes)]
Seed = Annotated[int, Parameter(converter=_whole, validator=Number(gte=0, lt=2**63))]
Count = Annotated[int, Parameter(converter=_whole, validator=Number(gte=1, lte=65536))]
Order = Annotated[int, Parameter(converter=_whole, validator=Number(gte=1, lte=64))]
Triangles = Annotated[int, Parameter(converter=_whole, validator=Number(gte=4, lte=10**9))]
Steps = Annotated[int, Parameter(converter=_whole, validator=Number(gte=0, lte=100))]
TrainingSeed = Annotated[int, Parameter(converter=_whole, validator=Number(gte=0, lte=10**9))]
TrainingSteps = Annotated[int, Parameter(converter=_whole, validator=Number(gte=1, lte=10**7))]
Quality = Annotated[int, Parameter(converter=_whole, validator=Number(gte=1, lte=100))]
Leds = Annotated[int, Parameter(converter=_whole, validator=Number(gte=1, lte=4096))]
Pixels = Annotated[int, Parameter(converter=_whole, validator=Number(gte=1, lte=10**12))]
Positive = Annotated[float, Parameter(converter=_real, validator=Number(gt=0, lte=1e6))]
NotNegative = Annotated[float, Parameter(converter=_real, validator=Number(gte=0, lte=1e6))]
Percent = Annotated[float, Parameter(converter=_real, validator=Number(gte=0, lte=100))]
# The range of `processing.curvatures.curvature`.
Probability = Annotated[float, Parameter(converter=_real, validator=Number(gt=0, lt=1))]
FitScale = Annotated[float, Parameter(converter=_real, validator=Number(gte=0.3, lte=100))]
# One day; the camera checks its own range.
Microseconds = Annotated[float, Parameter(converter=_real, validator=Number(gt=0, lte=8.64e10))]
LightDistance = Annotated[
    float | Literal["estimate"], Parameter(converter=_light_distance, n_tokens=1)
]
if TYPE_CHECKING:
    MethodChoice = processing.Method
else:  # with those that users have installed
    MethodChoice = Literal[processing.stereo.installed_methods()]
Gamma = Annotated[str, Parameter(converter=_gamma)]
Names = Annotated[tuple[str, ...], Parameter(converter=_names, n_tokens=1, metavar="LIST")]
Region = Annotated[
    tuple[int, int, int, int], Parameter(converter=_region, n_tokens=1, metavar="X,Y,W,H")
]
Millimetres = Annotated[float, Parameter(converter=_real, validator=Number(gte=-1e6, lte=1e6))]
Degrees = Annotated[float, Parameter(converter=_real, validator=Number(gte=-3600, lte=3600))]
Factor = Annotated[float, Parameter(converter=_real, validator=Number(gte=-1000, lte=1000))]


def named(exclude: Iterable[str]) -> tuple[str, ...]:
    """Return the entries of --exclude that name images; ``auto`` names none."""
    return tuple(name for name in exclude if name.lower() != "auto")


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RecordingOptions:
    """Options for reading a recording with its lights.

    Parameters
    ----------
    lights
        Lights file: lights.json, .lp, CSV or DiLiGenT text; or rig: the LEDs at led_positions_mm of
        the rig file; default: the lights of the source.
    camera
        Camera file (camera.json, or one of OpenCV, COLMAP, AliceVision, or a 3x3 matrix); default:
        the camera of the session, else that of the focal length that the images state in Exif. If
        the lights have positions, its working distance or the size of a pixel is required.
    mask
        Mask image of the object; default: the mask of the source, else one made from the images.
    spheres
        Estimate the lights from chrome spheres that lie next to the object, and leave the spheres
        out of its mask. With --out, lights.json and lights.png are written, too.
    radius_mm
        With --spheres: radius of the spheres in mm, as for `sgp calibrate spheres`; without it,
        the lights have directions instead of positions. Without the working distance of a camera,
        the lights have directions, and the radius gives the size of a pixel.
    rig
        Rig file (.toml) whose led_positions_mm are the lights with --lights rig, or are compared
        with the lights of --spheres; default: the rig that recorded the session, if it is known.
    distant
        Treat lights with positions as distant lights: use their directions only.
    gamma
        Transfer curve of the images: auto (their metadata; without metadata, 8-bit JPEGs are sRGB
        and other files linear), srgb, linear, an exponent such as 2.2, or a file with a table of
        samples and light.
    flat
        Flat field of the camera and its lens, from `sgp calibrate flat`: flat.json or its folder.
    exclude
        Images to leave out, by name or number: L07,L12 or 0-5,8. The number is the one in the name.
        auto leaves out images that the other images contradict, and divides those of which only
        the brightness is wrong by it.
    crop
        Region x,y,w,h to use: column and row of its first pixel, width and height, in pixels.
    downscale
        Average blocks of this many pixels per axis, after cropping. A size of a pixel in mm is
        still that of the recording.
    sensor
        sensor.json of `sgp calibrate sensor`, which gives noise, black and white level; default:
        the sensor that the session states.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    """

    lights: OptionalLights = None
    camera: OptionalInput = None
    mask: OptionalInput = None
    spheres: bool = False
    radius_mm: tuple[Positive, ...] = ()
    rig: RigOption = None
    distant: bool = False
    gamma: Gamma = "auto"
    flat: OptionalInput = None
    exclude: Names = ()
    crop: Region | None = None
    downscale: Count = 1
    sensor: OptionalInput = None
    max_pixels: Pixels = MAX_PIXELS

    @property
    def excluded_by_name(self) -> tuple[str, ...]:
        """Return the images that the user names."""
        return named(self.exclude)

    @property
    def exclude_disagreeing(self) -> bool:
        """Return whether images that the others contradict are left out."""
        return len(self.excluded_by_name) < len(self.exclude)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RemedyOptions(RecordingOptions):
    """Options that answer what the images of a recording show.

    Parameters
    ----------
    light_distance_mm
        Distance in mm of the lights of a list of directions, such as the .lp of a dome, from the
        middle of the object: they are near lights then, which needs a scale. estimate finds it in
        the images. With --out, lights.json with the positions is written, too.
    ambient
        estimate finds a constant light that is in all images, such as that of the room, and
        subtracts it; at least 5 lights at different elevations determine it.
    semi_calibrated
        Estimate the strengths of the lights with the normals. With --out, lights.json with the new
        intensities and their standard deviations is written, too.
    """

    light_distance_mm: LightDistance | None = None
    ambient: Literal["none", "estimate"] = "none"
    semi_calibrated: bool = False


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class SourceOptions(RemedyOptions):
    """Options for estimating normals from a recording.

    Parameters
    ----------
    method
        ls (plain least squares), trimmed (without the darkest and brightest fifth of the samples),
        cauchy (gives shadows and highlights a low weight), or best (also fits reflectances; the
        most accurate, but takes about three times as long as cauchy on glossy surfaces), or an
        estimator that is installed in the group sgp.estimators.
    channel
        auto (joint if its predicted errors are smaller than those of gray, else gray), gray,
        rgb (one solution per channel, averaged), joint (one normal and one albedo per channel
        that explain all channels best), or mosaic (the normal of every site of a
        colour mosaic from its own samples, without interpolation between pixels).
    height_mm
        Mean height of the object above the working plane, for lights with positions; default: the
        one that explains the images best.
    rests_on_plane
        The lowest points of the object are in the working plane, for lights with positions.
    interreflection
        Subtract the light that a concave matte object reflects onto itself, if attached shadows
        show it. It takes some seconds and up to 300 MB more.
    align
        auto (if camera or object surely moved while the images were taken, move the images back;
        with --spheres, follow the spheres), always (also by hundredths of a pixel), or off.
    """

    method: MethodChoice = "best"
    channel: processing.stereo.StereoChannel = "auto"
    height_mm: Millimetres | None = None
    rests_on_plane: bool = False
    interreflection: bool = False
    align: processing.recording.AlignChoice = "auto"

    def stage(self, pixel_mm: float | None = None) -> processing.recording.NormalsStage:
        """Return the computation of normals with these options, and the size of a pixel."""
        named = (field.name for field in fields(processing.recording.NormalsStage))
        stated = {name: getattr(self, name) for name in named if name != "pixel_mm"}
        return processing.recording.NormalsStage(pixel_mm=pixel_mm, **stated)


def require_inputs(command: Callable[..., object], arguments: Mapping[str, object]) -> None:
    """Check the inputs of a command before it runs, because its readers take a second to load.

    Raises
    ------
    MissingPathError
        If an argument of the type `Input` does not exist.
    """
    for path in inputs_of(command, arguments):
        if not path.exists():
            raise acquisition.missing_path(path)


def distinct(sources: Sequence[Path]) -> dict[Path, Path]:
    """Return sources by the places to which they lead.

    Raises
    ------
    UsageError
        If one is given twice, under whatever path.
    """
    places: dict[Path, Path] = {}
    for source in sources:
        place = source.resolve()
        if place in places:
            same = "" if source == places[place] else f" and as {places[place]}"
            raise UsageError(f"{source} is given twice{same}: give each source once")
        places[place] = source
    return places


def inputs_of(command: Callable[..., object], arguments: Mapping[str, object]) -> Iterator[Path]:
    """Yield the paths among the arguments of a command that have the type `Input`."""
    hints = get_type_hints(command, include_extras=True)
    for name, value in arguments.items():
        if is_dataclass(value):
            yield from inputs_of(type(value), vars(value))
            continue
        kind = getattr(hints.get(name), "__metadata__", ())
        if _INPUT in kind or (_LIGHTS in kind and value != RIG_LIGHTS):
            yield from paths_of([value])


def paths_of(values: Iterable[object]) -> list[Path]:
    """Return the paths among some arguments, including options with several values."""
    several = (value if isinstance(value, (list, tuple)) else (value,) for value in values)
    return [path for group in several for path in group if isinstance(path, Path)]


def transfer_of(gamma: str) -> acquisition.TransferCurve | None:
    """Return the transfer curve that an option names; None for auto.

    Raises
    ------
    DataError
        If it names a file without a valid table.
    """
    match gamma.lower():
        case "auto":
            return None
        case "linear":
            return acquisition.LINEAR
        case "srgb":
            return acquisition.SRGB
    if transfer_files(gamma):
        return acquisition.value_files.read_transfer(gamma)
    return acquisition.TransferCurve.power(float(gamma))


def transfer_files(gamma: str) -> list[Path]:
    """Return the file that the option names, if it names one."""
    # Not with pathlib, which raises an error if a name is too long.
    named = gamma.lower() not in _CURVES and os.path.isfile(gamma)
    return [Path(gamma)] if named else []


def numbers(option: str, text: str, count: int) -> list[float]:
    """Read ``x,y,...``.

    Raises
    ------
    UsageError
        If there are not ``count`` finite numbers.
    """
    try:
        values = [_finite(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count:
        raise UsageError(f"{option} {_short(text)}: give {count} numbers separated by commas")
    return values


def led_list(option: str, text: str) -> tuple[int, ...]:
    """Read a list of LEDs with ranges, such as ``0-5,8``.

    Raises
    ------
    UsageError
        If the text has another form, lists an LED twice, or is a single number, which used to be a
        number of LEDs.
    """
    alone = text.strip()
    if re.fullmatch("[0-9]{1,5}", alone):
        raise UsageError(
            f"{option} {alone} is ambiguous: write --led-count {alone} for {alone} LEDs, or "
            f"{option} {alone}-{alone} for LED {alone}"
        )
    try:
        leds = acquisition.plan.led_numbers(text)
    except ValueError as error:
        raise UsageError(f"{option}: {error}") from error
    twice = next((led for led, count in Counter(leds).items() if count > 1), None)
    if twice is not None:
        raise UsageError(f"{option}: LED {twice} is listed twice: list each LED once")
    return leds


def image_size(option: str, text: str) -> tuple[int, int]:
    """Read ``WxH``; returns (width, height).

    Raises
    ------
    UsageError
        If the text has another form, or the size has more pixels than a projection may have.
    """
    match = re.fullmatch(r"([1-9]\d{0,8})x([1-9]\d{0,8})", text)
    if match is None:
        raise UsageError(
            f"{option} {_short(text)}: give width and height in pixels, for example 640x512"
        )
    width, height = int(match[1]), int(match[2])
    if width * height > processing.projection.MAX_PROJECTED_PIXELS:
        most = processing.projection.MAX_PROJECTED_PIXELS // 10**6
        raise UsageError(f"{option} {text}: the maximum is {most} million pixels")
    return width, height
