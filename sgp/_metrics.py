"""The figures of each command: the `metrics` of its result and of its record.

Every figure has a type, a unit and a meaning; docs/result-format.md lists them. A figure that is
not required is only there in the cases that its meaning names. A figure that may be None may also
be NaN, and is null in files.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final, Literal, NotRequired

# Before Python 3.12, pydantic cannot check a `typing.TypedDict`.
from typing_extensions import TypedDict

# Of the record that a command leaves in its output folder: docs/result-format.md.
RECORD_FORMAT: Final = "sgp-result"
RECORD_VERSION: Final = 1


class QualityMetrics(TypedDict, total=False):
    """Agreement of images, lights and normals; records of earlier programs do not have them."""

    residual_relative: Annotated[
        float | None,
        "0..1",
        "median over the object of the rms deviation of lit samples from the lights, relative to "
        "the signal",
    ]
    consistency: Annotated[
        float | None,
        "0..1",
        "the same deviation from combinations of three images, whatever the lights",
    ]
    samples_used: Annotated[
        float | None, "0..1", "share of the samples that are neither saturated nor in shadow"
    ]
    curl: Annotated[
        float | None,
        "0..1",
        "disagreement of the mixed derivatives of the normals: 0 for a surface, 1 for a mirrored "
        "one, .7 for noise",
    ]
    image_residuals: Annotated[
        list[float], "1", "median deviation of each image from the lights, relative to the signal"
    ]
    light_errors_deg: Annotated[
        list[float],
        "deg",
        "angle between each light and the one that the images show, if they do",
    ]
    light_gains: Annotated[
        list[float], "1", "brightness of each image relative to its light, in the same cases"
    ]


class InspectMetrics(QualityMetrics):
    """Figures of an inspection."""

    images: Annotated[int, "", "images that show light, each with its light"]
    lights: Annotated[Literal["near", "distant"], "", "`near` if the lights have positions"]
    pixels: Annotated[int, "px", "size of the mask"]


class NormalsMetrics(QualityMetrics):
    """Figures of an estimation of normals."""

    images: Annotated[int, "", "images that were used, each with its light"]
    lights: Annotated[Literal["near", "distant"], "", "`near` if the lights have positions"]
    pixels: Annotated[int, "px", "size of the mask"]
    coverage: Annotated[
        float,
        "0..1",
        "share of the mask that has a normal; with a ground truth, only pixels with a true normal "
        "count",
    ]
    residual_rms: Annotated[
        float | None,
        "white level",
        "rms deviation of the images from the estimate, over the pixels with a normal; null if it "
        "exceeds the range of numbers",
    ]
    mae_deg: NotRequired[
        Annotated[
            float,
            "deg",
            "mean angle to the ground truth, if the source has one; a pixel without a normal "
            "counts as 90",
        ]
    ]
    median_deg: NotRequired[Annotated[float, "deg", "median of the same angles"]]


class SeparationMetrics(TypedDict):
    """Figures of a separation into shape and detail."""

    separability_deg: Annotated[
        float, "deg", "mean angle between the shape component of the detail and z; 0 is best"
    ]


class SurfaceMetrics(TypedDict):
    """Figures of a surface."""

    unit: Annotated[Literal["mm", "px"], "", "unit of heights; `px` if the scale is not known"]
    height_range: Annotated[float, "`unit`", "highest minus lowest point"]
    vertices: Annotated[int, "", "vertices of the surface, one for each pixel with a height"]
    parts: Annotated[int, "", "connected parts"]
    iterations: Annotated[int, "", "iterations of the solver"]
    disagreement_deg: NotRequired[
        Annotated[
            float, "deg", "median angle between the given normals and the normals of the surface"
        ]
    ]


class StagesMetrics(TypedDict):
    """Figures of the stages of the pipeline, by stage."""

    normals: Annotated[NormalsMetrics, "", "figures of the first stage"]
    detail: Annotated[SeparationMetrics, "", "figures of the second stage"]
    surface: Annotated[SurfaceMetrics, "", "figures of the third stage"]


class TruthMetrics(TypedDict, total=False):
    """Figures of the pipeline if the source has a ground truth."""

    normals_mae_deg: Annotated[
        float, "deg", "`mae_deg` of the normals, if the source has a ground truth"
    ]


class RunMetrics(StagesMetrics, TruthMetrics):
    """Figures of the pipeline."""

    seconds: Annotated[dict[str, float], "s", "duration of each stage"]


class ErrorMetrics(TypedDict):
    """Errors of the demo's results with respect to the simulator's ground truth."""

    light_error_deg: Annotated[
        float, "deg", "mean angle between the estimated and true light directions"
    ]
    light_error_mm: Annotated[float, "mm", "mean distance between estimated and true lights"]
    light_error_percent: Annotated[
        float, "%", "mean deviation of the intensities of the lights, relative to their mean"
    ]
    normals_mae_deg: Annotated[
        float, "deg", "mean angle to the true normals; a pixel without a normal counts as 90"
    ]
    normals_coverage: Annotated[float, "0..1", "share of the object that has a normal"]
    height_mae_mm: Annotated[float, "mm", "mean error of the height, after removing its mean"]
    height_coverage: Annotated[float, "0..1", "share of the object that has a height"]
    height_relative_error: Annotated[
        float, "1", "`height_mae_mm` divided by the range of the true height"
    ]


class DemoMetrics(StagesMetrics, ErrorMetrics):
    """Figures of the demo."""

    seconds: Annotated[dict[str, float], "s", "duration of each stage"]


class CombineMetrics(TypedDict):
    """Figures of a combination of shape and detail."""

    pixels: Annotated[int, "px", "pixels with a normal"]


class HeightProfileMetrics(TypedDict, total=False):
    """Figures of the height profile of a transfer."""

    height_rms_px: Annotated[
        float, "px", "`--profile`: rms difference between the surfaces of target and result"
    ]
    height_smoothed_rms_px: Annotated[
        float, "px", "the same after averaging the heights of the result over 5 x 5 pixels"
    ]
    height_range_px: Annotated[
        float, "px", "`--profile`: highest minus lowest point of the target's surface"
    ]


class TransferMetrics(HeightProfileMetrics):
    """Figures of a transfer of detail."""

    shape_mae_deg: Annotated[
        float, "deg", "mean angle between the shape components of target and result"
    ]
    detail_mae_deg: Annotated[
        float, "deg", "mean angle between the transferred detail and the detail of the result"
    ]
    shape_mae_deg_paper: Annotated[float, "deg", "the same as `shape_mae_deg`, filter of order 1"]
    detail_mae_deg_paper: Annotated[float, "deg", "the same as `detail_mae_deg`, filter of order 1"]
    shape_ssim: Annotated[float, "up to 1", "SSIM of the two shape components, over the mask"]
    shape_ssim_paper: Annotated[float, "up to 1", "the same in the paper's protocol"]
    detail_ssim: Annotated[float, "up to 1", "SSIM of the two details, over the mask"]
    detail_ssim_paper: Annotated[float, "up to 1", "the same in the paper's protocol"]
    pixels: Annotated[int, "px", "pixels that received detail"]
    seam_step_deg: NotRequired[
        Annotated[
            float | None,
            "deg",
            "local transfer: mean angle between neighbouring normals across the seam; null if "
            "there is no seam",
        ]
    ]
    interior_step_deg: NotRequired[
        Annotated[
            float | None,
            "deg",
            "local transfer: the same inside the region; null if it has no interior",
        ]
    ]
    seam_ratio: NotRequired[
        Annotated[
            float | None,
            "1",
            "local transfer: `seam_step_deg` / `interior_step_deg`; null if it is not defined",
        ]
    ]
    source_window: NotRequired[
        Annotated[
            tuple[int, int, int, int],
            "px",
            "global transfer: column, row, width and height of the used part of the source",
        ]
    ]
    tiles: NotRequired[
        Annotated[tuple[int, int], "", "global transfer: copies of the window, across and down"]
    ]


class LikenessMetrics(TypedDict):
    """Similarity of two details."""

    mae_deg: Annotated[float, "deg", "mean angle"]
    ssim: Annotated[float, "up to 1", "SSIM over the mask"]
    ssim_paper: Annotated[float, "up to 1", "SSIM in the paper's protocol"]


class RotationSimilarityMetrics(TypedDict):
    """Mean rotation between the shape normals of each pixel and its neighbours."""

    angle_deg: Annotated[float, "deg", "angle of the rotation"]
    norm_1: Annotated[float, "1", "1-norm of the rotation matrix minus the identity"]
    norm_2: Annotated[float, "1", "2-norm of it"]
    norm_inf: Annotated[float, "1", "infinity norm of it"]


class ChainStepMetrics(TypedDict):
    """One step of a chain of transfers."""

    target: Annotated[str, "", "path of the map that received the detail"]
    to_previous: Annotated[LikenessMetrics, "", "similarity to the transferred detail"]
    to_original: Annotated[LikenessMetrics, "", "similarity to the detail of the source"]
    shape_mae_deg: Annotated[
        float, "deg", "mean angle between the shape components of target and result"
    ]
    pixels: Annotated[int, "px", "pixels that were compared, the same in all steps"]


class PropertiesMetrics(TypedDict):
    """Figures of the properties of a map's detail."""

    separability_deg: Annotated[
        float, "deg", "mean angle between the shape component of the detail and z; 0 is best"
    ]
    detail_to_map_ssim: Annotated[float, "up to 1", "SSIM of detail and map, over the mask"]
    detail_to_map_ssim_paper: Annotated[float, "up to 1", "the same in the paper's protocol"]
    rotation_similarity: Annotated[
        RotationSimilarityMetrics, "", "rotations between neighbouring shape normals"
    ]
    idempotence: Annotated[
        dict[str, LikenessMetrics],
        "",
        "similarity of the detail of order 2, 3 and 4 to the detail of order 1; by order",
    ]
    chain: NotRequired[
        Annotated[
            list[ChainStepMetrics],
            "",
            "with targets: transfers from target to target and back to the first",
        ]
    ]
    exchange_detail_mae_deg: NotRequired[
        Annotated[
            list[float],
            "deg",
            "with targets: `detail_mae_deg` of the transfers to the first target and from it",
        ]
    ]
    exchange_shape_mae_deg: NotRequired[
        Annotated[list[float], "deg", "with targets: `shape_mae_deg` of the same transfers"]
    ]


class ProjectMetrics(TypedDict):
    """Figures of a projection of a mesh or a point cloud."""

    width: Annotated[int, "px", "width of the image"]
    height: Annotated[int, "px", "height of the image"]
    mm_per_px: Annotated[
        float, "mm", "size of a pixel on the object; with a camera, at the working distance"
    ]
    pixels: Annotated[int, "px", "pixels on the object"]
    height_range_mm: Annotated[float, "mm", "highest minus lowest point"]
    vertices: Annotated[int, "", "vertices or points in the file"]
    faces: Annotated[int, "", "faces in the file; 0 for points"]
    unit: Annotated[Literal["um", "mm", "cm", "m", "in"], "", "unit of the coordinates in the file"]


class CompareMetrics(TypedDict):
    """Figures of a comparison of two normal maps."""

    mae_deg: Annotated[
        float, "deg", "mean angle; a pixel without a normal in the first map counts as 90"
    ]
    median_deg: Annotated[float, "deg", "median of the same angles"]
    coverage: Annotated[float, "0..1", "share of the mask that has a normal in the first map"]
    ssim: Annotated[float, "up to 1", "SSIM over the mask"]
    ssim_paper: Annotated[float, "up to 1", "SSIM in the paper's protocol"]


class BenchMetrics(TypedDict):
    """Figures of the paper's tables; the tables are in tables.json."""

    tables: Annotated[int, "", "tables that were computed"]
    runs: Annotated[int, "", "runs per measurement"]
    quick: Annotated[bool, "", "whether `--quick` was given"]


class ExportMetrics(TypedDict):
    """Figures of an export of a session."""

    images: Annotated[int, "", "images that were written"]
    values: Annotated[Literal["raw", "linear"], "", "values of the images, as in `--values`"]
    subtracted: Annotated[str, "", "what was subtracted from the frames"]
    black_level_dn: Annotated[float, "DN", "black level of the images"]
    white_level_dn: Annotated[float, "DN", "white level of the images"]
    exposures_us: Annotated[list[float], "µs", "exposure times of the images, shortest first"]


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


class LightDifferenceMetrics(TypedDict):
    """Figures of a light in a comparison of two calibrations."""

    id: Annotated[str, "", "name of the light"]
    angle_deg: Annotated[float, "deg", "angle between its directions from the origin"]
    distance_mm: Annotated[
        float | None, "mm", "distance between its positions; null for directions"
    ]
    intensity_percent: Annotated[
        float | None,
        "%",
        "difference of its intensity after removing `intensity_factor`; null if only one of the "
        "calibrations has intensities",
    ]
    deviations: Annotated[
        float | None,
        "1",
        "difference of position or direction in combined standard deviations; null if they are "
        "not known or zero",
    ]
    intensity_deviations: Annotated[float | None, "1", "the same for the intensity"]
    rest_deg: Annotated[
        float, "deg", "angle that remains after exchanges, a mirror image and the common motion"
    ]
    rest_mm: Annotated[float | None, "mm", "distance that remains after these; null for directions"]
    beyond: Annotated[bool, "", "whether a difference is beyond its limit"]


class MotionMetrics(TypedDict):
    """Figures of a motion that all lights have in common."""

    angle_deg: Annotated[float, "deg", "angle of the rotation about the origin"]
    axis: Annotated[tuple[float, float, float], "1", "unit axis of the rotation, right-handed"]
    shift_mm: Annotated[tuple[float, float, float], "mm", "shift after the rotation"]


class CheckMetrics(TypedDict):
    """Figures of a comparison of two calibrations, or of a calibration and a rig file."""

    lights: Annotated[int, "", "lights that were compared"]
    near: Annotated[bool, "", "whether the lights have positions"]
    beyond: Annotated[int, "", "lights beyond a limit"]
    intensity_factor: Annotated[
        float | None,
        "1",
        "common factor of all intensities, which is no difference; null if only one of the "
        "calibrations has intensities",
    ]
    motion: NotRequired[
        Annotated[MotionMetrics, "", "motion that all lights have in common, if there is one"]
    ]
    mirrored: Annotated[
        str, "", "`x` if left and right are exchanged, `y` for top and bottom, else empty"
    ]
    reversed: Annotated[bool, "", "whether the order is reversed"]
    exchanged: Annotated[list[list[str]], "", "groups of lights at the places of one another"]
    differences: Annotated[list[LightDifferenceMetrics], "", "each light, the worst first"]


class SimulateMetrics(TypedDict):
    """Figures of a simulated recording."""

    lights: Annotated[int, "", "lights of the scene"]
    width: Annotated[int, "px", "width of the images"]
    height: Annotated[int, "px", "height of the images"]
    exposures_us: Annotated[list[float], "µs", "exposure times"]
    pixels: Annotated[int, "px", "pixels of the object"]
    spheres: Annotated[int, "", "chrome spheres in the image"]
    seconds: Annotated[dict[str, float], "s", "duration of each stage"]


# The figures of each command. Those of the stages of `sgp run` follow: each leaves a record.
COMMANDS: Final[Mapping[str, tuple[type, ...]]] = {
    "sgp normals": (NormalsMetrics,),
    "sgp inspect": (InspectMetrics,),
    "sgp surface": (SurfaceMetrics,),
    "sgp run": (RunMetrics, NormalsMetrics, SeparationMetrics, SurfaceMetrics),
    "sgp demo": (DemoMetrics,),
    "sgp detail separate": (SeparationMetrics,),
    "sgp detail combine": (CombineMetrics,),
    "sgp detail transfer": (TransferMetrics,),
    "sgp detail properties": (PropertiesMetrics,),
    "sgp project": (ProjectMetrics,),
    "sgp compare": (CompareMetrics,),
    "sgp bench paper": (BenchMetrics,),
    "sgp capture export": (ExportMetrics,),
    "sgp calibrate spheres": (SpheresMetrics,),
    "sgp calibrate intensities": (IntensitiesMetrics,),
    "sgp calibrate check": (CheckMetrics,),
    "sgp simulate": (SimulateMetrics,),
}
