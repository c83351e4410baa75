"""The figures of the commands that calibrate lights, camera and sensor; see `sgp._metrics`."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired

# Before Python 3.12, pydantic cannot check a `typing.TypedDict`.
from typing_extensions import TypedDict


class SphereMetrics(TypedDict):
    """Figures of a chrome sphere."""

    centre_px: Annotated[tuple[float, float], "px", "column and row of the centre of its outline"]
    semi_axes_px: Annotated[tuple[float, float], "px", "semi-axes of its outline"]
    centre_mm: Annotated[
        tuple[float, float, float] | None,
        "mm",
        "its centre; null unless camera and radius are known",
    ]
    radius_mm: Annotated[float | None, "mm", "its radius; null unless camera and radius are known"]
    coverage: Annotated[float, "0..1", "visible share of its outline"]
    rms_px: Annotated[float, "px", "scatter of the points of its outline"]
    recording: NotRequired[
        Annotated[str, "", "the recording that shows it, if there are several recordings"]
    ]


class SpheresMetrics(TypedDict):
    """Figures of a calibration of lights from chrome spheres."""

    lights: Annotated[int, "", "lights that were estimated"]
    near: Annotated[bool, "", "whether the lights have positions"]
    spheres: Annotated[list[SphereMetrics], "", "spheres that were used"]
    residual_deg: Annotated[
        float | None,
        "deg",
        "mean angle between the lights and the directions measured at the spheres; null if one "
        "sphere gave directions",
    ]


class IntensitiesMetrics(TypedDict):
    """Figures of a calibration of intensities from a matte card or ball."""

    intensities: Annotated[
        list[float], "1", "intensity of each light, relative to their mean; mean of the channels"
    ]
    intensity_std: Annotated[
        list[float], "1", "standard deviation of each intensity, that of the worst channel"
    ]
    intensities_rgb: NotRequired[
        Annotated[
            list[tuple[float, float, float]],
            "1",
            "`--channel rgb`: intensities of each light, relative to the mean of the channel",
        ]
    ]
    mu: Annotated[float, "1", "mean exponent of the radiation patterns of the lights"]
    mu_each: Annotated[list[float], "1", "exponent of each light"]
    mu_std: Annotated[list[float], "1", "standard deviation of each exponent"]
    mu_own: Annotated[
        list[bool], "", "whether the card determines the exponent of each light; else it is shared"
    ]
    mu_spread: Annotated[float, "1", "standard deviation of the exponents among the lights"]
    axis_std_deg: Annotated[list[float], "deg", "standard deviation of each axis"]
    axis_own: Annotated[
        list[bool], "", "whether the card determines the axis of each light; else it is the given"
    ]
    axis_spread_deg: Annotated[
        float, "deg", "standard deviation among the lights of a component of their axes"
    ]
    residual: Annotated[float, "1", "relative deviation of the card from the model"]
    pixels: Annotated[int, "px", "pixels of the card that were used"]
    vignetting_corner: NotRequired[
        Annotated[
            float, "1", "`--even`: brightness of the corners relative to the middle of the image"
        ]
    ]
    vignetting_corner_std: NotRequired[Annotated[float, "1", "`--even`: its standard deviation"]]


class SensorMetrics(TypedDict):
    """Figures of a calibration of a sensor, with standard deviations."""

    electrons_per_dn: Annotated[float, "e/DN", "electrons per grey value, the inverse of the gain"]
    electrons_per_dn_sigma: Annotated[float, "e/DN", "its standard deviation"]
    read_noise_e: Annotated[float, "e", "temporal noise in the dark, without quantisation"]
    read_noise_e_sigma: Annotated[float, "e", "its standard deviation"]
    black_level_dn: Annotated[float, "DN", "mean without light at an exposure time of 0"]
    black_level_dn_sigma: Annotated[float, "DN", "its standard deviation"]
    dsnu_e: Annotated[float, "e", "standard deviation of the pixels in the dark"]
    dsnu_e_sigma: Annotated[float, "e", "its standard deviation"]
    prnu: Annotated[float, "1", "relative standard deviation of the pixels' response"]
    prnu_sigma: Annotated[float, "1", "its standard deviation"]
    linearity_error: Annotated[float, "1", "mean relative deviation from a straight line"]
    linearity_error_sigma: Annotated[float, "1", "its standard deviation"]
    dark_current_e_per_s: NotRequired[
        Annotated[float, "e/s", "dark current, if dark frames have several exposure times"]
    ]
    dark_current_e_per_s_sigma: NotRequired[Annotated[float, "e/s", "its standard deviation"]]
    full_well_e: NotRequired[
        Annotated[float, "e", "electrons of saturated samples, if exposures saturate"]
    ]
    full_well_e_sigma: NotRequired[Annotated[float, "e", "its standard deviation"]]
    full_well_limit: NotRequired[
        Annotated[Literal["converter", "pixel"], "", "what saturates, if exposures do"]
    ]
    saturation_capacity_e: NotRequired[
        Annotated[float, "e", "electrons where the temporal variance is largest, if it falls"]
    ]
    saturation_capacity_e_sigma: NotRequired[Annotated[float, "e", "its standard deviation"]]
    snr_max: NotRequired[Annotated[float, "1", "signal-to-noise ratio at that signal"]]
    snr_max_sigma: NotRequired[Annotated[float, "1", "its standard deviation"]]
    dynamic_range: NotRequired[
        Annotated[float, "1", "that signal over the one with a signal-to-noise ratio of 1"]
    ]
    dynamic_range_sigma: NotRequired[Annotated[float, "1", "its standard deviation"]]
    hot_pixel_fraction: Annotated[float, "0..1", "share of pixels with far more dark current"]
    hot_pixel_e_per_s: Annotated[float, "e/s", "their mean additional dark current"]
    gain_db: Annotated[float, "dB", "analogue gain of the recordings"]
    exposures: Annotated[int, "", "different exposure times"]
    frames: Annotated[int, "", "frames that were read, with dark frames"]


class FlatMetrics(TypedDict):
    """Figures of a flat field from a matte card."""

    corners: Annotated[
        list[float],
        "1",
        "smooth part in the corners, from the upper left by rows; 1 is the middle of the image",
    ]
    gradient_std: Annotated[
        float | None,
        "1",
        "standard deviation of a linear gradient of the flat from the middle to a corner, because "
        "the lights may have the same; null if the lights have no standard deviations of their "
        "positions",
    ]
    prnu: Annotated[
        float,
        "1",
        "standard deviation among the pixels of the pixel part, without its noise; with one "
        "recording, the texture of the card is in it",
    ]
    pixel_std: Annotated[float, "1", "standard deviation of the pixel part by temporal noise"]
    card_std: Annotated[
        float | None,
        "1",
        "standard deviation of the texture of the card that is left; null with one recording",
    ]
    uneven: Annotated[
        float | None,
        "1",
        "rms difference between the smooth parts of the recordings, without a gradient; null with "
        "one recording",
    ]
    stains: Annotated[int, "px", "pixels at which the recordings contradict each other"]
    covered: Annotated[float, "0..1", "share of the image that the card covers"]
    residual: Annotated[float, "1", "relative deviation of the card from the model of its lights"]
    lights: Annotated[int, "", "lights"]
    frames: Annotated[int, "", "frames of lit cards"]


class BoardMetrics(TypedDict):
    """Figures of a calibration board."""

    width_mm: Annotated[float, "mm", "width of all squares together"]
    height_mm: Annotated[float, "mm", "height of all squares together"]
    corners: Annotated[int, "", "inner corners of the squares"]
    markers: Annotated[int, "", "markers"]


class CameraMetrics(TypedDict):
    """Figures of a calibration of a camera from views of a board."""

    images: Annotated[int, "", "images that were searched for the board"]
    views: Annotated[int, "", "places of the board that were used"]
    focal_px: Annotated[tuple[float, float], "px", "focal lengths in x and y"]
    centre_px: Annotated[tuple[float, float], "px", "principal point"]
    distortion: Annotated[list[float], "1", "coefficients k1, k2, p1, p2, k3"]
    std: Annotated[
        dict[str, float],
        "",
        "standard deviations of fx, fy, cx, cy in px and of the coefficients that the views "
        "determine; the other coefficients are 0",
    ]
    corner_std_px: Annotated[float, "px", "standard deviation of a coordinate of a corner"]
    coverage: Annotated[float, "0..1", "share of the field of view that the board covered"]
    bare_corners: Annotated[list[str], "", "corners of the image that the board hardly covered"]
    view_rms_px: Annotated[
        dict[str, float], "px", "rms distance between seen and predicted corners of each view"
    ]
    views_left_out: Annotated[list[str], "", "views that contradict the others"]
    working_distance_mm: NotRequired[
        Annotated[float, "mm", "`--working-plane`: distance of the working plane"]
    ]
    working_distance_std_mm: NotRequired[
        Annotated[float, "mm", "`--working-plane`: its standard deviation"]
    ]
    mm_per_px: NotRequired[
        Annotated[float, "mm", "`--working-plane`: size of a pixel on the working plane"]
    ]
    working_plane_tilt_deg: NotRequired[
        Annotated[float, "deg", "`--working-plane`: angle between the board and the image plane"]
    ]
