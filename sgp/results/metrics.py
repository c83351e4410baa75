"""The figures of each command: the `metrics` of its result and of its record.

Every figure has a type, a unit and a meaning, from which the site lists them. A figure that is not
required is only there in the cases that its meaning names. A figure that may be None may also
be NaN, and is null in files.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Literal, NotRequired, TypeVar, cast

# Before Python 3.12, pydantic cannot check a `typing.TypedDict`.
from typing_extensions import TypedDict

from sgp.results.stage_metrics import (
    CurvatureMetrics,
    InspectMetrics,
    NormalsMetrics,
    SeparationMetrics,
    SurfaceMetrics,
)

# Of the record that a command leaves in its output folder.
RECORD_FORMAT: Final = "sgp-result"
RECORD_VERSION: Final = 1

Figures = TypeVar("Figures")


def figures_of(kind: type[Figures], *values: object, **stated: object) -> Figures:
    """Return the figures of a type that are stated, or that values have under the same names.

    Of several values that have a figure, the first one counts.
    """
    names, found = [*kind.__annotations__], dict[str, object]()
    for value in reversed(values):
        found |= {name: getattr(value, name) for name in names if hasattr(value, name)}
    found |= stated
    return cast("Figures", {name: found[name] for name in names if name in found})


class SphereMetrics(TypedDict):
    """Figures of a chrome sphere.

    Parameters
    ----------
    centre_px : px
        column and row of the centre of its outline
    semi_axes_px : px
        semi-axes of its outline
    centre_mm : mm
        its centre; null unless camera and radius are known
    radius_mm : mm
        its radius; null unless camera and radius are known
    coverage : 0..1
        visible share of its outline
    rms_px : px
        scatter of its edge about its outline; null if only what it mirrors determines the outline
    recording
        the recording that shows it, if there are several recordings
    """

    centre_px: tuple[float, float]
    semi_axes_px: tuple[float, float]
    centre_mm: tuple[float, float, float] | None
    radius_mm: float | None
    coverage: float
    rms_px: float
    recording: NotRequired[str]


class SpheresMetrics(TypedDict):
    """Figures of a calibration of lights from chrome spheres.

    Parameters
    ----------
    lights
        lights that were estimated
    near
        whether the lights have positions
    spheres
        spheres that were used
    residual_deg : deg
        mean angle between the lights and the directions measured at the spheres; null if one sphere
        gave directions
    pixel_mm : mm
        size of a pixel at the height of the centres of the spheres, if their radius is known and
        the camera is not
    pixel_sigma_mm : mm
        standard deviation of pixel_mm
    """

    lights: int
    near: bool
    spheres: list[SphereMetrics]
    residual_deg: float | None
    pixel_mm: NotRequired[float]
    pixel_sigma_mm: NotRequired[float]


class IntensitiesMetrics(TypedDict):
    """Figures of a calibration of intensities from a matte card or ball.

    Parameters
    ----------
    intensities : 1
        intensity of each light, relative to their mean; mean of the channels
    intensity_std : 1
        standard deviation of each intensity, that of the worst channel
    intensities_rgb : 1
        `--channel rgb`: intensities of each light, relative to the mean of the channel
    mu : 1
        mean exponent of the radiation patterns of the lights
    mu_each : 1
        exponent of each light
    mu_std : 1
        standard deviation of each exponent
    mu_own
        whether the card determines the exponent of each light; else it is shared
    mu_spread : 1
        standard deviation of the exponents among the lights
    axis_std_deg : deg
        standard deviation of each axis
    axis_own
        whether the card determines the axis of each light; else it is the given
    axis_spread_deg : deg
        standard deviation among the lights of a component of their axes
    residual : 1
        relative deviation of the card from the model
    pixels : px
        pixels of the card that were used
    vignetting_corner : 1
        `--even`: brightness of the corners relative to the middle of the image
    vignetting_corner_std : 1
        `--even`: its standard deviation
    """

    intensities: list[float]
    intensity_std: list[float]
    intensities_rgb: NotRequired[list[tuple[float, float, float]]]
    mu: float
    mu_each: list[float]
    mu_std: list[float]
    mu_own: list[bool]
    mu_spread: float
    axis_std_deg: list[float]
    axis_own: list[bool]
    axis_spread_deg: float
    residual: float
    pixels: int
    vignetting_corner: NotRequired[float]
    vignetting_corner_std: NotRequired[float]


class SensorMetrics(TypedDict):
    """Figures of a calibration of a sensor, with standard deviations.

    Parameters
    ----------
    electrons_per_dn : e/DN
        electrons per grey value, the inverse of the gain
    electrons_per_dn_sigma : e/DN
        its standard deviation
    read_noise_e : e
        temporal noise in the dark, without quantisation
    read_noise_e_sigma : e
        its standard deviation
    black_level_dn : DN
        mean without light at an exposure time of 0
    black_level_dn_sigma : DN
        its standard deviation
    dsnu_e : e
        standard deviation of the pixels in the dark
    dsnu_e_sigma : e
        its standard deviation
    prnu : 1
        relative standard deviation of the pixels' response
    prnu_sigma : 1
        its standard deviation
    linearity_error : 1
        mean relative deviation from a straight line
    linearity_error_sigma : 1
        its standard deviation
    dark_current_e_per_s : e/s
        dark current, if dark frames have several exposure times
    dark_current_e_per_s_sigma : e/s
        its standard deviation
    full_well_e : e
        electrons of saturated samples, if exposures saturate
    full_well_e_sigma : e
        its standard deviation
    full_well_limit
        what saturates, if exposures do
    saturation_capacity_e : e
        electrons where the temporal variance is largest, if it falls
    saturation_capacity_e_sigma : e
        its standard deviation
    snr_max : 1
        signal-to-noise ratio at that signal
    snr_max_sigma : 1
        its standard deviation
    dynamic_range : 1
        that signal over the one with a signal-to-noise ratio of 1
    dynamic_range_sigma : 1
        its standard deviation
    hot_pixel_fraction : 0..1
        share of pixels with far more dark current
    hot_pixel_e_per_s : e/s
        their mean additional dark current
    gain_db : dB
        analogue gain of the recordings
    exposures
        different exposure times
    frames
        frames that were read, with dark frames
    """

    electrons_per_dn: float
    electrons_per_dn_sigma: float
    read_noise_e: float
    read_noise_e_sigma: float
    black_level_dn: float
    black_level_dn_sigma: float
    dsnu_e: float
    dsnu_e_sigma: float
    prnu: float
    prnu_sigma: float
    linearity_error: float
    linearity_error_sigma: float
    dark_current_e_per_s: NotRequired[float]
    dark_current_e_per_s_sigma: NotRequired[float]
    full_well_e: NotRequired[float]
    full_well_e_sigma: NotRequired[float]
    full_well_limit: NotRequired[Literal["converter", "pixel"]]
    saturation_capacity_e: NotRequired[float]
    saturation_capacity_e_sigma: NotRequired[float]
    snr_max: NotRequired[float]
    snr_max_sigma: NotRequired[float]
    dynamic_range: NotRequired[float]
    dynamic_range_sigma: NotRequired[float]
    hot_pixel_fraction: float
    hot_pixel_e_per_s: float
    gain_db: float
    exposures: int
    frames: int


class FlatMetrics(TypedDict):
    """Figures of a flat field from a matte card.

    Parameters
    ----------
    corners : 1
        smooth part in the corners, from the upper left by rows; 1 is the middle of the image
    gradient_std : 1
        standard deviation of a linear gradient of the flat from the middle to a corner, because the
        lights may have the same; null if the lights have no standard deviations of their positions
    prnu : 1
        standard deviation among the pixels of the pixel part, without its noise; with one
        recording, the texture of the card is in it
    pixel_std : 1
        standard deviation of the pixel part by temporal noise
    card_std : 1
        standard deviation of the texture of the card that is left; null with one recording
    uneven : 1
        rms difference between the smooth parts of the recordings, without a gradient; null with one
        recording
    stains : px
        pixels at which the recordings contradict each other
    covered : 0..1
        share of the image that the card covers
    residual : 1
        relative deviation of the card from the model of its lights
    lights
        lights
    frames
        frames of lit cards
    """

    corners: list[float]
    gradient_std: float | None
    prnu: float
    pixel_std: float
    card_std: float | None
    uneven: float | None
    stains: int
    covered: float
    residual: float
    lights: int
    frames: int


class BoardMetrics(TypedDict):
    """Figures of a calibration board.

    Parameters
    ----------
    width_mm : mm
        width of all squares together
    height_mm : mm
        height of all squares together
    corners
        inner corners of the squares
    markers
        markers
    """

    width_mm: float
    height_mm: float
    corners: int
    markers: int


class CameraMetrics(TypedDict):
    """Figures of a calibration of a camera from views of a board.

    Parameters
    ----------
    images
        images that were searched for the board
    views
        places of the board that were used
    focal_px : px
        focal lengths in x and y
    centre_px : px
        principal point
    distortion : 1
        coefficients k1, k2, p1, p2, k3
    std
        standard deviations of fx, fy, cx, cy in px and of the coefficients that the views
        determine; the other coefficients are 0
    corner_std_px : px
        standard deviation of a coordinate of a corner
    coverage : 0..1
        share of the field of view that the board covered
    bare_corners
        corners of the image that the board hardly covered
    view_rms_px : px
        rms distance between seen and predicted corners of each view
    views_left_out
        views that contradict the others
    working_distance_mm : mm
        `--working-plane`: distance of the working plane
    working_distance_std_mm : mm
        `--working-plane`: its standard deviation
    mm_per_px : mm
        `--working-plane`: size of a pixel on the working plane
    working_plane_tilt_deg : deg
        `--working-plane`: angle between the board and the image plane
    """

    images: int
    views: int
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: list[float]
    std: dict[str, float]
    corner_std_px: float
    coverage: float
    bare_corners: list[str]
    view_rms_px: dict[str, float]
    views_left_out: list[str]
    working_distance_mm: NotRequired[float]
    working_distance_std_mm: NotRequired[float]
    mm_per_px: NotRequired[float]
    working_plane_tilt_deg: NotRequired[float]


class LightDifferenceMetrics(TypedDict):
    """Figures of a light in a comparison of two calibrations.

    Parameters
    ----------
    id
        name of the light
    angle_deg : deg
        angle between its directions from the origin
    distance_mm : mm
        distance between its positions; null for directions
    intensity_percent : %
        difference of its intensity after removing `intensity_factor`; null if only one of the
        calibrations has intensities
    deviations : 1
        difference of position or direction in combined standard deviations; null if they are not
        known or zero
    intensity_deviations : 1
        the same for the intensity
    rest_deg : deg
        angle that remains after exchanges, a mirror image and the common motion
    rest_mm : mm
        distance that remains after these; null for directions
    beyond
        whether a difference is beyond its limit
    """

    id: str
    angle_deg: float
    distance_mm: float | None
    intensity_percent: float | None
    deviations: float | None
    intensity_deviations: float | None
    rest_deg: float
    rest_mm: float | None
    beyond: bool


class MotionMetrics(TypedDict):
    """Figures of a motion that all lights have in common.

    Parameters
    ----------
    angle_deg : deg
        angle of the rotation about the origin
    axis : 1
        unit axis of the rotation, right-handed
    shift_mm : mm
        shift after the rotation
    """

    angle_deg: float
    axis: tuple[float, float, float]
    shift_mm: tuple[float, float, float]


class CheckMetrics(TypedDict):
    """Figures of a comparison of two calibrations, or of a calibration and a rig file.

    Parameters
    ----------
    lights
        lights that were compared
    near
        whether the lights have positions
    beyond
        lights beyond a limit
    intensity_factor : 1
        common factor of all intensities, which is no difference; null if only one of the
        calibrations has intensities
    motion
        motion that all lights have in common, if there is one
    mirrored
        `x` if left and right are exchanged, `y` for top and bottom, else empty
    reversed
        whether the order is reversed
    exchanged
        groups of lights at the places of one another
    differences
        each light, the worst first
    """

    lights: int
    near: bool
    beyond: int
    intensity_factor: float | None
    motion: NotRequired[MotionMetrics]
    mirrored: str
    reversed: bool
    exchanged: list[list[str]]
    differences: list[LightDifferenceMetrics]


class DriftCalibrationMetrics(TypedDict):
    """Figures of a calibration in a series.

    Parameters
    ----------
    name
        its file
    time_utc
        its date; null unless all calibrations state one
    common_deg : deg
        what the motion that all lights have in common turns them by; null with fewer than 5 lights
    common_ratio : 1
        this motion in units of its limit; null with fewer than 5 lights
    """

    name: str
    time_utc: str | None
    common_deg: float | None
    common_ratio: float | None


class DriftLightMetrics(TypedDict):
    """Figures of a light in a series of calibrations.

    Parameters
    ----------
    id
        name of the light
    direction_deg : deg
        largest deviation of its direction from the middle of the series
    direction_ratio : 1
        largest deviation of its direction in units of the limit
    strength_percent : %
        largest deviation of its strength; null if fewer than 3 calibrations have intensities
    strength_ratio : 1
        largest deviation of its strength in units of the limit; null as before
    beyond
        whether one of them is beyond a limit
    """

    id: str
    direction_deg: float
    direction_ratio: float
    strength_percent: float | None
    strength_ratio: float | None
    beyond: bool


class DriftMetrics(TypedDict):
    """Figures of a comparison of three or more calibrations.

    Parameters
    ----------
    lights
        lights that were compared
    beyond
        lights beyond a limit
    moved
        whether a motion that all lights have in common is beyond its limit
    false_alarm : 1
        probability that a stable series has any value beyond a limit
    common_limit_deg : deg
        turn of all lights that reaches the limit; null with fewer than 5 lights
    calibrations
        each calibration in the order of time
    drifts
        each light, the worst first
    """

    lights: int
    beyond: int
    moved: bool
    false_alarm: float
    common_limit_deg: float | None
    calibrations: list[DriftCalibrationMetrics]
    drifts: list[DriftLightMetrics]


class CombineMetrics(TypedDict):
    """Figures of a combination of shape and detail.

    Parameters
    ----------
    pixels : px
        pixels with a normal
    """

    pixels: int


class HeightProfileMetrics(TypedDict, total=False):
    """Figures of the height profile of a transfer.

    Parameters
    ----------
    height_rms_px : px
        `--profile`: rms difference between the surfaces of target and result
    height_smoothed_rms_px : px
        the same after averaging the heights of the result over 5 x 5 pixels
    height_range_px : px
        `--profile`: highest minus lowest point of the target's surface
    """

    height_rms_px: float
    height_smoothed_rms_px: float
    height_range_px: float


class TransferMetrics(HeightProfileMetrics):
    """Figures of a transfer of detail.

    Parameters
    ----------
    shape_mae_deg : deg
        mean angle between the shape components of target and result
    detail_mae_deg : deg
        mean angle between the transferred detail and the detail of the result
    shape_mae_deg_paper : deg
        the same as `shape_mae_deg`, filter of order 1
    detail_mae_deg_paper : deg
        the same as `detail_mae_deg`, filter of order 1
    shape_ssim : up to 1
        SSIM of the two shape components, over the mask
    shape_ssim_paper : up to 1
        the same in the paper's protocol
    detail_ssim : up to 1
        SSIM of the two details, over the mask
    detail_ssim_paper : up to 1
        the same in the paper's protocol
    pixels : px
        pixels that received detail
    seam_step_deg : deg
        mean angle between neighbouring normals across the seam of a local transfer, or of the
        detail across the borders of tiles; null without a seam
    interior_step_deg : deg
        the same inside the region, or inside tiles; null if there is no interior
    seam_ratio : 1
        `seam_step_deg` / `interior_step_deg`; null if it is not defined
    source_window : px
        global transfer: column, row, width and height of the used part of the source
    tiles
        global transfer: copies of the window, across and down
    """

    shape_mae_deg: float
    detail_mae_deg: float
    shape_mae_deg_paper: float
    detail_mae_deg_paper: float
    shape_ssim: float
    shape_ssim_paper: float
    detail_ssim: float
    detail_ssim_paper: float
    pixels: int
    seam_step_deg: NotRequired[float | None]
    interior_step_deg: NotRequired[float | None]
    seam_ratio: NotRequired[float | None]
    source_window: NotRequired[tuple[int, int, int, int]]
    tiles: NotRequired[tuple[int, int]]


class LikenessMetrics(TypedDict):
    """Similarity of two details.

    Parameters
    ----------
    mae_deg : deg
        mean angle
    ssim : up to 1
        SSIM over the mask
    ssim_paper : up to 1
        SSIM in the paper's protocol
    """

    mae_deg: float
    ssim: float
    ssim_paper: float


class RotationSimilarityMetrics(TypedDict):
    """Mean rotation between the shape normals of each pixel and its neighbours.

    Parameters
    ----------
    angle_deg : deg
        angle of the rotation
    norm_1 : 1
        1-norm of the rotation matrix minus the identity
    norm_2 : 1
        2-norm of it
    norm_inf : 1
        infinity norm of it
    """

    angle_deg: float
    norm_1: float
    norm_2: float
    norm_inf: float


class ChainStepMetrics(TypedDict):
    """One step of a chain of transfers.

    Parameters
    ----------
    target
        path of the map that received the detail
    to_previous
        similarity to the transferred detail
    to_original
        similarity to the detail of the source
    shape_mae_deg : deg
        mean angle between the shape components of target and result
    pixels : px
        pixels that were compared, the same in all steps
    """

    target: str
    to_previous: LikenessMetrics
    to_original: LikenessMetrics
    shape_mae_deg: float
    pixels: int


class PropertiesMetrics(TypedDict):
    """Figures of the properties of a map's detail.

    Parameters
    ----------
    separability_deg : deg
        mean angle between the shape component of the detail and z; 0 is best
    detail_to_map_ssim : up to 1
        SSIM of detail and map, over the mask
    detail_to_map_ssim_paper : up to 1
        the same in the paper's protocol
    rotation_similarity
        rotations between neighbouring shape normals
    idempotence
        similarity of the detail of order 2, 3 and 4 to the detail of order 1; by order
    chain
        with targets: transfers from target to target and back to the first
    exchange_detail_mae_deg : deg
        with targets: `detail_mae_deg` of the transfers to the first target and from it
    exchange_shape_mae_deg : deg
        with targets: `shape_mae_deg` of the same transfers
    """

    separability_deg: float
    detail_to_map_ssim: float
    detail_to_map_ssim_paper: float
    rotation_similarity: RotationSimilarityMetrics
    idempotence: dict[str, LikenessMetrics]
    chain: NotRequired[list[ChainStepMetrics]]
    exchange_detail_mae_deg: NotRequired[list[float]]
    exchange_shape_mae_deg: NotRequired[list[float]]


class SynthesisMetrics(TypedDict):
    """Figures of a synthesised detail component relative to its exemplar.

    Of sheets larger than 2048 x 2048 pixels, the middle is measured.

    Parameters
    ----------
    detail_angle_deg : deg
        mean angle between the detail and z
    exemplar_angle_deg : deg
        the same of the exemplar
    slope_distance : 1
        Wasserstein distance between the angles to z of sheet and exemplar, relative to the standard
        deviation of the exemplar's; null if all its angles are equal
    spectrum_distance : Np
        mean absolute difference of the log power of the slopes of sheet and exemplar over 16 radial
        bands; null if no block of 32 x 32 pixels fits into both
    exemplar_spectrum_distance : Np
        the same between two halves of the exemplar
    repeat_score : up to 1
        largest normalised autocorrelation of the slopes at lags of at least a patch; null if the
        sheet is too small
    exemplar_repeat_score : up to 1
        the same of the exemplar
    cut_step_deg : deg
        mean angle between neighbouring normals of different patches; null with one patch
    inside_step_deg : deg
        the same inside patches
    shape_mae_deg : deg
        `--onto`: mean angle between the shape components of target and result
    detail_mae_deg : deg
        `--onto`: mean angle between the synthesised detail and the detail of the result
    detail_ssim : up to 1
        `--onto`: SSIM of the two details, over the mask
    detail_ssim_paper : up to 1
        `--onto`: the same in the paper's protocol
    compressed_share : 1
        `--onto`: share of the pixels in patches that are smaller, since the exemplar has no room
        for their footprints
    """

    detail_angle_deg: float
    exemplar_angle_deg: float
    slope_distance: float | None
    spectrum_distance: float | None
    exemplar_spectrum_distance: float | None
    repeat_score: float | None
    exemplar_repeat_score: float | None
    cut_step_deg: float | None
    inside_step_deg: float | None
    shape_mae_deg: NotRequired[float]
    detail_mae_deg: NotRequired[float]
    detail_ssim: NotRequired[float]
    detail_ssim_paper: NotRequired[float]
    compressed_share: NotRequired[float]


class FillMetrics(TypedDict):
    """Figures of a map whose holes were filled.

    Parameters
    ----------
    pixels : px
        pixels with a normal
    filled_pixels : px
        pixels in holes, all invented
    detail_angle_deg : deg
        mean angle between the detail and z in the holes
    surroundings_angle_deg : deg
        the same in the surroundings that were used
    seam_step_deg : deg
        mean angle between neighbouring normals across the rims of the holes
    interior_step_deg : deg
        the same inside the holes; null if they have no interior
    seam_ratio : 1
        `seam_step_deg` / `interior_step_deg`
    """

    pixels: int
    filled_pixels: int
    detail_angle_deg: float
    surroundings_angle_deg: float
    seam_step_deg: float
    interior_step_deg: float | None
    seam_ratio: float | None


class SuperresMetrics(TypedDict):
    """Figures of a normal map that was enlarged.

    Parameters
    ----------
    width : px
        width of the result
    height : px
        height of the result
    pixels : px
        pixels with a normal
    invented_share : 0..1
        share of the detail that the network added: its mean square, relative to its sum with that
        of the detail of an interpolation
    added_deg : deg
        mean angle between the result and an interpolation
    normal_sigma_deg : deg
        median of the predicted standard deviations of the normals; null for bicubic interpolation
    model_sha256
        hash of the network's file; null for bicubic interpolation
    pixel_mm : mm
        size of a pixel of the result, if that of the given map is known
    """

    width: int
    height: int
    pixels: int
    invented_share: float
    added_deg: float
    normal_sigma_deg: float | None
    model_sha256: str | None
    pixel_mm: NotRequired[float]


class TrainMetrics(TypedDict):
    """Figures of the training of a network.

    Parameters
    ----------
    steps
        steps of the training
    parameters
        weights of the network
    bicubic_mae_deg : deg
        mean angular error of bicubic interpolation on held-out surfaces
    network_mae_deg : deg
        the same of the network
    actual_over_predicted : 1
        actual over predicted deviation of the network's normals, for each tenth of the pixels in
        order of the prediction; 1 is best
    """

    steps: int
    parameters: int
    bicubic_mae_deg: float
    network_mae_deg: float
    actual_over_predicted: list[float]


class RtiMetrics(TypedDict):
    """Figures of an export for viewers of relightable images.

    Parameters
    ----------
    fitted_to
        the recorded images, or the shading of normals and albedo if the images are gone
    directions
        directions of the lights: the same for all pixels; at the points of the surface; or at a
        plane at the mean height
    lights
        directions that the functions were fitted to
    coefficients
        coefficients of a function
    pixels : px
        pixels of the object
    pixels_without_samples : px
        pixels of the images without any sample, which are black
    white : white level
        light that is the value 1
    fit_rms : 1
        median over the object of the rms deviation of the fit; white is 1
    ptm_rms : 1/255
        `--basis ptm`: rms that 8 bits in relight.ptm add
    ptm_largest : 1/255
        the largest of these deviations
    planes_rms : 1/255
        rms that 8 bits and JPEG add to the planes
    """

    fitted_to: Literal["images", "normals"]
    directions: Literal["distant", "surface", "plane"]
    lights: int
    coefficients: int
    pixels: int
    pixels_without_samples: int
    white: float
    fit_rms: float
    ptm_rms: NotRequired[float]
    ptm_largest: NotRequired[float]
    planes_rms: float


class X3pMetrics(TypedDict):
    """Figures of a surface that was exported for programs for surface texture.

    Parameters
    ----------
    points
        points with a height
    pixel_mm : mm
        distance between neighbouring points
    height_range_mm : mm
        difference between the highest and the lowest point
    width_error_percent : %
        of a perspective surface: error of widths at the height that is furthest from 0
    """

    points: int
    pixel_mm: float
    height_range_mm: float
    width_error_percent: NotRequired[float]


class RelightMetrics(TypedDict):
    """Figures of an image under a light.

    Parameters
    ----------
    width : px
        width of the image
    height : px
        height of the image
    colours
        one function for all colours, or for each
    direction : 1
        unit vector toward the light
    """

    width: int
    height: int
    colours: Literal["lrgb", "rgb"]
    direction: list[float]


class StagesMetrics(TypedDict):
    """Figures of the stages of the pipeline, by stage.

    Parameters
    ----------
    normals
        figures of the first stage
    detail
        figures of the second stage
    surface
        figures of the third stage
    """

    normals: NormalsMetrics
    detail: SeparationMetrics
    surface: SurfaceMetrics


class TruthMetrics(TypedDict, total=False):
    """Figures of the pipeline if the source has a ground truth.

    Parameters
    ----------
    normals_mae_deg : deg
        `mae_deg` of the normals, if the source has a ground truth
    """

    normals_mae_deg: float


class RunMetrics(StagesMetrics, TruthMetrics):
    """Figures of the pipeline.

    Parameters
    ----------
    seconds : s
        duration of each stage
    """

    seconds: dict[str, float]


class ErrorMetrics(TypedDict):
    """Errors of the demo's results with respect to the simulator's ground truth.

    Parameters
    ----------
    light_error_deg : deg
        mean angle between the estimated and true light directions
    light_error_mm : mm
        mean distance between estimated and true lights
    light_error_percent : %
        mean deviation of the intensities of the lights, relative to their mean
    normals_mae_deg : deg
        mean angle to the true normals; a pixel without a normal counts as 90
    normals_resolved_mae_deg : deg
        the same with respect to the true normals blurred as the lens blurs the images
    normals_coverage : 0..1
        share of the object that has a normal
    height_mae_mm : mm
        mean error of the height, after removing its mean
    height_coverage : 0..1
        share of the object that has a height
    height_relative_error : 1
        `height_mae_mm` divided by the range of the true height
    """

    light_error_deg: float
    light_error_mm: float
    light_error_percent: float
    normals_mae_deg: float
    normals_resolved_mae_deg: float
    normals_coverage: float
    height_mae_mm: float
    height_coverage: float
    height_relative_error: float


class DemoMetrics(StagesMetrics, ErrorMetrics):
    """Figures of the demo.

    Parameters
    ----------
    seconds : s
        duration of each stage
    """

    seconds: dict[str, float]


class ProjectMetrics(TypedDict):
    """Figures of a projection of a mesh or a point cloud.

    Parameters
    ----------
    width : px
        width of the image
    height : px
        height of the image
    mm_per_px : mm
        size of a pixel on the object; with a camera, at the working distance
    pixels : px
        pixels on the object
    height_range_mm : mm
        highest minus lowest point
    vertices
        vertices or points in the file
    faces
        faces in the file; 0 for points
    unit
        unit of the coordinates in the file
    """

    width: int
    height: int
    mm_per_px: float
    pixels: int
    height_range_mm: float
    vertices: int
    faces: int
    unit: Literal["um", "mm", "cm", "m", "in"]


class CompareMetrics(TypedDict):
    """Figures of a comparison of two normal maps.

    Parameters
    ----------
    mae_deg : deg
        mean angle; a pixel without a normal in the first map counts as 90
    median_deg : deg
        median of the same angles
    coverage : 0..1
        share of the mask that has a normal in the first map
    ssim : up to 1
        SSIM over the mask
    ssim_paper : up to 1
        SSIM in the paper's protocol
    """

    mae_deg: float
    median_deg: float
    coverage: float
    ssim: float
    ssim_paper: float


class FieldMetrics(TypedDict):
    """Figures of a field of view that was joined with others.

    Parameters
    ----------
    field
        its folder
    column_px : px
        column of its middle in the whole
    row_px : px
        row of its middle in the whole
    turn_deg : deg
        angle from right to down by which it is turned in the whole
    tilt_deg : deg
        angle by which its normals were tilted; 0 if the overlaps show no tilt
    albedo_gain : 1
        factor by which its albedo was multiplied; the geometric mean of all is 1
    """

    field: str
    column_px: float
    row_px: float
    turn_deg: float
    tilt_deg: float
    albedo_gain: float


class FieldPairMetrics(TypedDict):
    """Figures of two fields that show a common area.

    Parameters
    ----------
    first
        folder of a field
    second
        folder of the other one
    used
        false if the pair contradicts the others
    common_px : px
        size of the common area
    correlation : 0..1
        of the fine structure in the common area
    residual_px : px
        rms distance of their pixels after the placements of all fields were adjusted
    deviations : 1
        the same in standard deviations of the registration
    disagreement : 1
        rms difference of the normals in their standard deviations; null if those are not known
    """

    first: str
    second: str
    used: bool
    common_px: int
    correlation: float
    residual_px: NotRequired[float]
    deviations: NotRequired[float]
    disagreement: NotRequired[float | None]


class QuantityMetrics(TypedDict):
    """A parameter of an area, a profile or a step.

    Parameters
    ----------
    name
        name of the parameter by its standard
    unit
        its unit; empty for a pure number
    value : `unit`
        the parameter without what noise adds; null if it is not defined
    sigma : `unit`
        its standard uncertainty; null if errors of the normals are not known
    measured : `unit`
        the parameter of the heights as they are, noise included
    budget : `unit`
        standard uncertainty by source: noise, noise level, lights, scale, filter, form
    doubts
        why the uncertainty is not assured; empty if it is
    """

    name: str
    unit: str
    value: float | None
    sigma: float | None
    measured: float | None
    budget: dict[str, float]
    doubts: list[str]


class MeasuredMetrics(TypedDict):
    """An area, a profile or a step that was measured.

    Parameters
    ----------
    name
        its name
    kind
        `area`, `profile` or `step`
    place
        `x,y,w,h` of the rectangle around an area, or the line, in pixels
    pixels : px
        pixels with a height
    pixel_mm : mm
        distance between neighbouring pixels at its mean height
    form
        form that was removed
    s_mm : mm
        nesting index of the S-filter
    l_mm : mm
        nesting index of the L-filter; 0 for none
    parameters
        the parameters
    """

    name: str
    kind: Literal["area", "profile", "step"]
    place: str
    pixels: int
    pixel_mm: NotRequired[float]
    form: NotRequired[str]
    s_mm: NotRequired[float]
    l_mm: NotRequired[float]
    parameters: list[QuantityMetrics]


class LimitMetrics(TypedDict):
    """A limit, and whether a part conforms to it (ISO 14253-1).

    Parameters
    ----------
    parameter
        name of the parameter
    region
        area or line
    least : unit of the parameter
        lower limit; null for none
    most : unit of the parameter
        upper limit; null for none
    answer
        `conforms`, `exceeded` or `undecided`
    """

    parameter: str
    region: str
    least: float | None
    most: float | None
    answer: Literal["conforms", "exceeded", "undecided"]


class RoughnessMetrics(TypedDict):
    """Figures of the roughness of a surface.

    Parameters
    ----------
    pixel_mm : mm
        size of a pixel at the mean height
    lens_blur_px : px
        standard deviation of the blur of the lens
    lateral_resolution_mm : mm
        length of the wave of which half of the amplitude remains
    regions
        what was measured
    limits
        `--limits`: each limit with its answer
    """

    pixel_mm: float
    lens_blur_px: float
    lateral_resolution_mm: float
    regions: list[MeasuredMetrics]
    limits: NotRequired[list[LimitMetrics]]


class MergeMetrics(TypedDict):
    """Figures of fields that were joined.

    Parameters
    ----------
    pixels : px
        pixels with a normal
    overlap : 0..1
        share of them that several fields show
    residual_px : px
        rms distance of the pixels of overlapping fields after the adjustment
    fields
        where each field is
    pairs
        the pairs of fields
    normal_sigma_deg : deg
        median of the standard deviations of the normals; null if they are not known
    normal_sigma_common_deg : deg
        the part of them that all pixels have in common, the largest of the fields
    pixel_mm : mm
        size of a pixel, if the records of the fields state it
    """

    pixels: int
    overlap: float
    residual_px: float
    fields: list[FieldMetrics]
    pairs: list[FieldPairMetrics]
    normal_sigma_deg: float | None
    normal_sigma_common_deg: float
    pixel_mm: NotRequired[float]


class LevelMetrics(TypedDict):
    """The smallest change of a surface that would have been found with 95 %.

    Parameters
    ----------
    width : mm or px
        full width at half depth; the diameter of a spot
    scratch : mm or px
        depth of a scratch of 20 pixels or more in length, at a usual place
    scratch_worst : mm or px
        the same at all but 5 % of the places
    spot : mm or px
        depth of a round spot, at a usual place
    spot_worst : mm or px
        the same at all but 5 % of the places
    """

    width: float
    scratch: float | None
    scratch_worst: float | None
    spot: float | None
    spot_worst: float | None


class RegisteredMetrics(TypedDict):
    """Figures of a comparison of two registered normal maps, `sgp compare --register`.

    Parameters
    ----------
    shift_px : px
        from the middle of the common area to its place in the second map: right, down
    turn_deg : deg
        turn of the second map in the plane, counterclockwise as seen
    tilt_deg : deg
        tilt of the second map in space
    registration_sigma_px : px
        standard deviation of a position
    correlation : up to 1
        correlation of the fine structure
    common : 0..1
        share of the first map that both show
    median_deg : deg
        median angle between registered normals
    unit
        `mm`, or `px` without a scale
    pixel_size : mm or px
        size of a pixel of the first map; 1 without a scale
    changes
        `--significance`: significant changes
    false_alarm : 0..1
        `--significance`: probability that a map without a change has one
    threshold : 1
        `--significance`: deviations above which a change is significant
    levels
        `--significance`: the smallest changes that would have been found
    """

    shift_px: tuple[float, float]
    turn_deg: float
    tilt_deg: float
    registration_sigma_px: float
    correlation: float
    common: float
    median_deg: float
    unit: Literal["mm", "px"]
    pixel_size: float
    changes: NotRequired[int]
    false_alarm: NotRequired[float]
    threshold: NotRequired[float]
    levels: NotRequired[list[LevelMetrics]]


class ExportMetrics(TypedDict):
    """Figures of an export of a session.

    Parameters
    ----------
    images
        images that were written
    values
        values of the images, as in `--values`
    subtracted
        what was subtracted from the frames
    black_level_dn : DN
        black level of the images
    white_level_dn : DN
        white level of the images
    exposures_us : µs
        exposure times of the images, shortest first
    """

    images: int
    values: Literal["raw", "linear"]
    subtracted: str
    black_level_dn: float
    white_level_dn: float
    exposures_us: list[float]


class BatchMetrics(TypedDict):
    """Figures of a batch.

    Parameters
    ----------
    sources
        recordings that were given
    done
        those with a result that is up to date
    failed
        those without one
    computed
        those that were computed by this run
    exceeded
        table `[roughness]` of the recipe: those that exceed a limit
    """

    sources: int
    done: int
    failed: int
    computed: int
    exceeded: NotRequired[int]


class SimulateMetrics(TypedDict):
    """Figures of a simulated recording.

    Parameters
    ----------
    lights
        lights of the scene
    width : px
        width of the images
    height : px
        height of the images
    exposures_us : µs
        exposure times
    pixels : px
        pixels of the object
    spheres
        chrome spheres in the image
    seconds : s
        duration of each stage
    """

    lights: int
    width: int
    height: int
    exposures_us: list[float]
    pixels: int
    spheres: int
    seconds: dict[str, float]


class ReportMetrics(TypedDict):
    """Figures of a report.

    Parameters
    ----------
    results
        result folders on the page
    bytes : bytes
        size of the page
    reduction
        pixels of each result for a pixel of the page, in rows and in columns
    """

    results: int
    bytes: int
    reduction: list[float]


class VerifyMetrics(TypedDict):
    """Figures of a comparison of results with their records.

    Parameters
    ----------
    records
        records, and files that state what they were computed from
    files
        files of results that were checked
    inputs
        inputs that were compared with their hashes
    inputs_missing
        inputs that are no longer there
    faults
        files that are missing, damaged or changed
    """

    records: int
    files: int
    inputs: int
    inputs_missing: int
    faults: int


# The figures of each command. Those of the stages of `sgp run` follow: each leaves a record.
COMMANDS: Final[Mapping[str, tuple[type, ...]]] = {
    "sgp normals": (NormalsMetrics,),
    "sgp inspect": (InspectMetrics,),
    "sgp surface": (SurfaceMetrics,),
    "sgp curvature": (CurvatureMetrics,),
    "sgp run": (RunMetrics, NormalsMetrics, SeparationMetrics, SurfaceMetrics),
    "sgp batch": (BatchMetrics,),
    "sgp demo": (DemoMetrics,),
    "sgp detail separate": (SeparationMetrics,),
    "sgp detail combine": (CombineMetrics,),
    "sgp detail transfer": (TransferMetrics,),
    "sgp detail properties": (PropertiesMetrics,),
    "sgp detail synthesize": (SynthesisMetrics,),
    "sgp detail fill": (FillMetrics,),
    "sgp detail superres": (SuperresMetrics,),
    "sgp detail train": (TrainMetrics,),
    "sgp project": (ProjectMetrics,),
    "sgp compare": (CompareMetrics, RegisteredMetrics),
    "sgp merge": (MergeMetrics,),
    "sgp roughness": (RoughnessMetrics,),
    "sgp export": (RtiMetrics, X3pMetrics),
    "sgp relight": (RelightMetrics,),
    "sgp capture export": (ExportMetrics,),
    "sgp calibrate spheres": (SpheresMetrics,),
    "sgp calibrate intensities": (IntensitiesMetrics,),
    "sgp calibrate flat": (FlatMetrics,),
    "sgp calibrate check": (CheckMetrics, DriftMetrics),
    "sgp calibrate sensor": (SensorMetrics,),
    "sgp calibrate board": (BoardMetrics,),
    "sgp calibrate camera": (CameraMetrics,),
    "sgp simulate": (SimulateMetrics,),
    "sgp report": (ReportMetrics,),
    "sgp verify": (VerifyMetrics,),
}
