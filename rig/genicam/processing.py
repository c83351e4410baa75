"""Which nodes of a camera alter its samples, and the values at which they do not.

The names are those of GenICam's standard features and words that several makers use in theirs; a
prefix of a maker, such as ``Bsl`` or ``mv``, and the case of letters are ignored.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Final, Literal

# What a node that alters samples and cannot be changed means: the camera cannot be used, or the
# setting is stated with the recording.
Locked = Literal["refused", "stated"]

_PREFIX: Final = "(?i)(?:Bsl|(?-i:[a-z]{2,4}(?=[A-Z])))?"
_SUFFIX: Final = (
    "(?:Adjustment|Correct(?:ion)?|Compensation|Function|Control)?"
    "(?:Mode)?(?:Enabled?|Active|Mode)?"
)
_DIGITAL: Final = "DigitalShift|BitShift|DigitalGain"
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
    signed
        Whether the value 0 is neutral only in a range with negative values.
    highest
        Largest upper limit of a range in which the neutral value is known: in a wider one, the
        number is no factor but has a scale that only the maker knows, for instance 1024 for 1.
    """

    effect: str
    switches: str = ""
    levels: str = ""
    neutral: float = 0.0
    locked: Locked = "refused"
    symbols: tuple[str, ...] = OFF
    required: bool = False
    entries: str = ""
    signed: bool = False
    highest: float = math.inf

    def has_switch(self, name: str) -> bool:
        """Return whether a boolean or enumeration of this name belongs to it."""
        pattern = f"{_PREFIX}(?:{self.switches}){_SUFFIX}"
        return bool(self.switches) and re.fullmatch(pattern, name) is not None

    def has_level(self, name: str) -> bool:
        """Return whether a number of this name belongs to it."""
        pattern = f"{_PREFIX}(?:{self.levels})(?:Abs|Param)?"
        return bool(self.levels) and re.fullmatch(pattern, name) is not None

    def knows(self, low: float, high: float) -> bool:
        """Return whether the neutral value of a level with this range is known."""
        return (low < 0 or not self.signed) and high <= self.highest


PROCESSING: Final = (
    Processing(
        "changes between frames",
        "(?:Exposure|Gain|BalanceWhite|BlackLevel)Auto|(?:Gain|BlackLevel)AutoBalance",
        required=True,
    ),
    Processing("changes between frames", "ExposureMode", symbols=("Timed",), required=True),
    Processing("replaces the image", "TestPattern|TestImageSelector", required=True),
    Processing(
        "changes between frames",
        r"\w+Auto|Auto(?:Exposure|Gain|WhiteBalance|Brightness)|ALC|AGC|AEC|AWB",
    ),
    Processing(
        "changes between frames", "Sequence(?:r(?:Configuration)?)?|Multi(?:ple)?Exposures?"
    ),
    Processing("bends the curve", "GammaSelector"),
    Processing("bends the curve", "Gamma", "Gamma(?:Correction)?", 1.0),
    Processing(
        "bends the curve",
        r"LUT|LookUpTable|\w*Tone(?:Mapping|Curve)?|Contrast(?:Enhancement)?|Companding|Knee(?:Point)?s?"
        r"|\w*(?:HDR|WDR|(?:High|Wide)DynamicRange)(?:Image|Output)?|Multi(?:ple)?Slope"
        "|Linear(?:ity)?(?=Correction)|HighlightReduction",
    ),
    Processing(
        "bends the curve", levels="Contrast|(?<=Bsl)Brightness", locked="stated", signed=True
    ),
    Processing(
        "mixes the colours",
        "LightSource(?:Preset|Selector)|ProcessedRaw|ISP|WhiteBalance|Saturation|Hue|CCM"
        "|(?:OnBoard)?Color(?:Transformation|Space|(?:Correction)?Matrix|Enhance(?:ment|r)|Balance"
        "|Process(?:ing)?)?|RGBTransform(?:ation)?",
    ),
    Processing("mixes the colours", levels="Hue", locked="stated", signed=True),
    Processing(
        "mixes the colours", levels="Saturation", neutral=1.0, locked="stated", highest=16.0
    ),
    Processing(
        "mixes neighbours",
        "Sharp(?:ness|ening)(?:Enhancement)?|EdgeEnhance(?:ment|r)|(?:Noise|Smear)Reduction"
        "|Denois(?:e|ing)|(?:Spatial|Temporal|Median|Smoothing|Image|Edge)Filter|Smoothing"
        "|Convolution|SuperBayer|FrameAverag(?:e|ing)|LowLightImaging",
        "Sharp(?:ness|ening)(?:Enhancement)?|NoiseReduction|Denois(?:e|ing)",
        locked="stated",
    ),
    Processing(
        "replaces defects by neighbours",
        "(?:(?:Static|Dynamic)?Defect(?:ive)?(?:Pixel)?|(?:Bad|Dead|Hot)Pixel)"
        "(?:Correct(?:ion)?(?:Static|Dynamic)?|Replacement|Mask(?:Column)?)?|DPC|Blemish"
        "|Pixel(?=Correct)",
    ),
    Processing(
        "scales pixels",
        "FlatField|FFC|(?:Lens)?Shading|LSC|Vignetting|AreaGain|(?:PR)?NUC?|FPNC?"
        "|(?:FixedPatternNoise|SensorEffect|Brightness)(?=Correction)",
        locked="stated",
    ),
    Processing("scales colours", levels="BalanceRatio", neutral=1.0, locked="stated", highest=64.0),
    Processing("scales samples", _DIGITAL, _DIGITAL, locked="stated"),
    Processing(
        "scales samples", levels="Gain", locked="stated", entries="(?:Digital|Red|Green|Blue)"
    ),
    Processing(
        "mirrors or turns",
        "Reverse[XY]|(?:Image|Horizontal|Vertical)?(?:Mirror|Flip|Rotation)"
        "(?:Horizontal|Vertical|X|Y)?|(?:Lens)?Distortion",
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
    r"\w*(?:Selector|Status|StatusAll|Temperature|Count|Available)|(?:Exposure|Gain)(?:Time)?(?:Abs"
    r"|Raw)?|(?:Acquisition|Action|Chunk|Event|File|Gev|Line|Ptp|Stream|TL|Timestamp|Transfer|"
    r"Trigger|User)\w*|(?:Counter|Timer)Value\w*|Device(?!ScanType|Tap)\w*"
)
