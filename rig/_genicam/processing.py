"""Which nodes of a camera alter its samples, and the values at which they do not.

The names are those of GenICam's standard features and words that several makers use in theirs; a
prefix of a maker, such as ``Bsl`` or ``mv``, is ignored.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final, Literal

# What a node that alters samples and cannot be changed means: the camera cannot be used, or the
# setting is stated with the recording.
Locked = Literal["refused", "stated"]

_PREFIX: Final = "(?:Bsl|[a-z]{2,4}(?=[A-Z]))?"
_SUFFIX: Final = "(?:Adjustment|Correction|Function|Control)?(?:Mode)?(?:Enabled?|Active|Mode)?"
# Symbols under which enumerations do nothing, by preference.
OFF: Final = ("Off", "None", "Disabled", "Disable", "Linear", "User", "Raw")


@dataclass(frozen=True)
class Processing:
    """One kind of processing in a camera.

    Parameters
    ----------
    effect
        What it does to the samples or the image: the reason to turn it off.
    switches
        Pattern of the names of booleans and enumerations that turn it on.
    levels
        Pattern of the names of numbers that set its strength.
    neutral
        Value of these numbers without effect.
    locked
        What it means that it cannot be turned off.
    symbols
        Symbols of the enumerations that do nothing, by preference.
    required
        Whether an enumeration must have such a symbol; others may be no switch.
    entries
        Pattern of the entries of the selector that are concerned, empty for all.
    """

    effect: str
    switches: str = ""
    levels: str = ""
    neutral: float = 0.0
    locked: Locked = "refused"
    symbols: tuple[str, ...] = OFF
    required: bool = False
    entries: str = ""

    def has_switch(self, name: str) -> bool:
        """Return whether a boolean or enumeration of this name belongs to it."""
        pattern = f"{_PREFIX}(?:{self.switches}){_SUFFIX}"
        return bool(self.switches) and re.fullmatch(pattern, name) is not None

    def has_level(self, name: str) -> bool:
        """Return whether a number of this name belongs to it."""
        pattern = f"{_PREFIX}(?:{self.levels})(?:Abs)?"
        return bool(self.levels) and re.fullmatch(pattern, name) is not None


PROCESSING: Final = (
    Processing(
        "changes between frames",
        "(?:Exposure|Gain|BalanceWhite|BlackLevel)Auto|(?:Gain|BlackLevel)AutoBalance",
        required=True,
    ),
    Processing("changes between frames", "ExposureMode", symbols=("Timed",), required=True),
    Processing("replaces the image", "TestPattern|TestImageSelector", required=True),
    Processing("changes between frames", r"\w+Auto|Auto(?:Exposure|Gain|WhiteBalance|Brightness)"),
    Processing(
        "changes between frames", "Sequence(?:r(?:Configuration)?)?|Multi(?:ple)?Exposures?"
    ),
    Processing("bends the curve", "GammaSelector"),
    Processing("bends the curve", "Gamma", "Gamma", 1.0),
    Processing(
        "bends the curve",
        r"LUT|LookUpTable|\w*Tone(?:Mapping|Curve)?|Contrast(?:Enhancement)?|Companding|Knee\w*"
        r"|\w*(?:HDR|WDR|(?:High|Wide)DynamicRange)|Multi(?:ple)?Slope|Linear(?:ity)?(?=Correction)",
    ),
    Processing("bends the curve", levels="Contrast|Brightness", locked="stated"),
    Processing(
        "mixes the colours",
        "LightSource(?:Preset|Selector)|ProcessedRaw|ISP|Isp|WhiteBalance|Saturation|Hue"
        "|Color(?:Transformation|Space|Matrix|Enhancement|Balance)?|R(?:gb|GB)Transform(?:ation)?",
    ),
    Processing("mixes the colours", levels="Hue", locked="stated"),
    Processing("mixes the colours", levels="Saturation", neutral=1.0, locked="stated"),
    Processing(
        "mixes neighbours",
        "Sharp(?:ness|ening)(?:Enhancement)?|EdgeEnhancement|NoiseReduction|Denois(?:e|ing)"
        "|(?:Spatial|Temporal|Median|Smoothing)Filter|Smoothing|FrameAverag(?:e|ing)"
        "|LowLightImaging",
        "Sharp(?:ness|ening)(?:Enhancement)?|NoiseReduction|Denois(?:e|ing)",
        locked="stated",
    ),
    Processing("replaces defects by neighbours", r"(?:[Dd]efect|(?:Bad|Dead|Hot)Pixel)\w*"),
    Processing("scales pixels", "FlatField|Ffc|FFC|(?:Lens)?Shading|Vignetting", locked="stated"),
    Processing("scales colours", levels="BalanceRatio", neutral=1.0, locked="stated"),
    Processing("scales samples", levels="DigitalShift|BitShift|DigitalGain", locked="stated"),
    Processing(
        "scales samples", levels="Gain", locked="stated", entries="(?:Digital|Red|Green|Blue)"
    ),
    Processing(
        "mirrors or turns",
        r"Reverse[XY]|(?:Image)?(?:Mirror|Flip|Rotation)\w*|(?:Lens)?Distortion",
    ),
    Processing(
        "adds samples",
        "Binning|Decimation|Sub[Ss]ampling",
        "(?:Binning|Decimation|Sub[Ss]ampling)(?:Horizontal|Vertical|X|Y)?",
        1.0,
        locked="stated",
    ),
    Processing("loses detail", "(?:Image|Lossy)?Compression"),
)

# Nodes that do not act on samples, and those that the rig sets and reports by itself.
UNRECORDED: Final = re.compile(
    r"\w*(?:Selector|Status|StatusAll|Temperature|Count|Available)|(?:Acquisition|Action|Chunk|Event"
    r"|ExposureTime|File|Gain|Gev|Line|Ptp|Stream|TL|Timestamp|Transfer|Trigger|User)\w*"
    r"|(?:Counter|Timer)Value\w*|Device(?!ScanType|Tap)\w*"
)
