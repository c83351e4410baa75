"""The figures of normals, components, surfaces and curvature; see `sgp._metrics`."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired

# Before Python 3.12, pydantic cannot check a `typing.TypedDict`.
from typing_extensions import TypedDict


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


class SampleShares(TypedDict):
    """Shares of the samples inside the mask; their sum is 1."""

    lit: Annotated[float, "0..1", "agree with a matte surface"]
    attached: Annotated[float, "0..1", "the surface faces away from the light"]
    cast: Annotated[float, "0..1", "something blocks the light"]
    saturated: Annotated[float, "0..1", "saturated in all exposures, or not measured"]
    outlier: Annotated[float, "0..1", "contradict the lit ones: highlights, light from elsewhere"]
    missing: Annotated[float, "0..1", "of lights that shine in another direction"]


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
    normal_sigma_deg: NotRequired[
        Annotated[
            float | None,
            "deg",
            "median over the pixels of the standard deviations of the normals; null if they are "
            "not known",
        ]
    ]
    normal_sigma_common_deg: NotRequired[
        Annotated[
            float | None,
            "deg",
            "median of the part of them that all pixels have in common: errors of the lights and "
            "of the mean height",
        ]
    ]
    noise_from: NotRequired[
        Annotated[
            Literal["sensor", "repeats", "residuals", "unknown"],
            "",
            "where the law of the noise is from, on which the standard deviations rest",
        ]
    ]
    neighbour_correlation: NotRequired[
        Annotated[
            float | None,
            "-1..1",
            "correlation between the residuals of each light and of the one nearest to it: about "
            "-.1 for noise; above .1 the surface is not matte; null with fewer than 8 lights",
        ]
    ]
    samples: NotRequired[
        Annotated[
            SampleShares,
            "",
            "what the samples inside the mask show",
        ]
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
    mean_height_mm: NotRequired[
        Annotated[float, "mm", "lights with positions: mean height of the object above the plane"]
    ]
    mean_height_sigma_mm: NotRequired[
        Annotated[
            float,
            "mm",
            "standard deviation of this height, from the scatter of residuals between pixels and "
            "lights and from stated errors of positions; absent if the height was stated or "
            "found together with strengths of lights",
        ]
    ]
    lowest_height_mm: NotRequired[
        Annotated[float, "mm", "height above the plane that 0.5 % of the object are below"]
    ]
    height_changes_mm: NotRequired[
        Annotated[
            list[float],
            "mm",
            "rms change of the heights in each step in which normals and heights were computed in "
            "turn",
        ]
    ]
    excluded: NotRequired[
        Annotated[
            list[str],
            "",
            "`--exclude auto`: images that were left out because others contradict them",
        ]
    ]
    strength_sigma: NotRequired[
        Annotated[
            float,
            "1",
            "`--semi-calibrated`: median of the relative standard deviations of the strengths, "
            "with 1 % for the height if it was found with them",
        ]
    ]


class SeparationMetrics(TypedDict):
    """Figures of a separation into shape and detail."""

    separability_deg: Annotated[
        float, "deg", "mean angle between the shape component of the detail and z; 0 is best"
    ]


class MeshMetrics(TypedDict, total=False):
    """Figures of meshes with fewer triangles than the surface."""

    triangles: Annotated[int, "", "triangles of each mesh, if a number was requested"]
    deviation_rms: Annotated[float, "`unit`", "distance of such a mesh from the surface, rms"]
    deviation_largest: Annotated[
        float, "`unit`", "largest distance of such a mesh from the surface"
    ]


class SurfaceMetrics(MeshMetrics):
    """Figures of a surface."""

    unit: Annotated[Literal["mm", "px"], "", "unit of heights; `px` if the scale is not known"]
    pixel_size: NotRequired[
        Annotated[
            float,
            "`unit`",
            "distance of neighbouring pixels; with a camera, at the working distance",
        ]
    ]
    camera_distance: NotRequired[
        Annotated[float, "`unit`", "distance of a perspective camera from height 0, along its axis"]
    ]
    camera_axis_px: NotRequired[
        Annotated[list[float], "px", "column and row at which this axis meets the map"]
    ]
    height_range: Annotated[float, "`unit`", "highest minus lowest point"]
    vertices: Annotated[int, "", "vertices of the surface, one for each pixel with a height"]
    parts: Annotated[int, "", "connected parts"]
    iterations: Annotated[int, "", "iterations of the solver"]
    disagreement_deg: NotRequired[
        Annotated[
            float, "deg", "median angle between the given normals and the normals of the surface"
        ]
    ]
    curl: NotRequired[
        Annotated[
            float | None,
            "0..1",
            "disagreement of the mixed derivatives of the normals: 0 for a surface, 1 for a "
            "mirrored one, .7 for noise",
        ]
    ]
    normal_residual_deg: NotRequired[
        Annotated[float, "deg", "mean angle between the given normals and those of the surface"]
    ]
    curl_deg: NotRequired[
        Annotated[
            float,
            "deg",
            "robust standard deviation of the curl of the normals, which is that of the normals if "
            "their errors are independent",
        ]
    ]
    curl_excess: NotRequired[
        Annotated[
            float, "1", "the same relative to the standard deviations of the normals: 1 for noise"
        ]
    ]
    blocks: NotRequired[
        Annotated[int, "", "`--memory`: blocks of rows in which the surface was solved"]
    ]
    block_rounds: NotRequired[
        Annotated[int, "", "rounds in which the blocks were corrected by their neighbours"]
    ]
    block_error: NotRequired[
        Annotated[
            float, "`unit`", "estimated largest difference from the surface solved as a whole"
        ]
    ]
    height_sigma: NotRequired[
        Annotated[
            float,
            "`unit`",
            "`--height-sigma`: median standard deviation of the heights, relative to the mean of "
            "their part or to the prior",
        ]
    ]
    difference_distances_px: NotRequired[
        Annotated[list[int], "px", "`--height-sigma`: distances in rows and columns"]
    ]
    difference_sigma: NotRequired[
        Annotated[
            list[float],
            "`unit`",
            "standard deviations of differences in height at these distances",
        ]
    ]
    prior_heights: NotRequired[
        Annotated[int, "", "`--prior`: pixels of the surface whose height is known"]
    ]
    prior_rms: NotRequired[
        Annotated[float, "`unit`", "rms difference between the surface and these heights"]
    ]
    jumps: NotRequired[
        Annotated[int, "", "`--discontinuity`: pairs of neighbours between which the surface jumps"]
    ]
    pieces: NotRequired[
        Annotated[int, "", "`--discontinuity`: pieces that no reliable pair of neighbours connects"]
    ]
    settled: NotRequired[
        Annotated[bool, "", "`--discontinuity`: whether the surface stood still in the last round"]
    ]


class CurvatureMetrics(TypedDict):
    """Figures of a map of curvatures."""

    unit: Annotated[Literal["mm", "px"], "", "unit of lengths; `px` if the scale is not known"]
    pixels: Annotated[int, "px", "pixels with a curvature"]
    scale: Annotated[float, "`unit`", "standard deviation of the weights of the fits"]
    mean_median: Annotated[
        float, "1/`unit`", "median of the mean curvature, positive where convex toward the camera"
    ]
    mean_rms: Annotated[float, "1/`unit`", "root mean square of the mean curvature"]
    gaussian_median: Annotated[float, "1/`unit`^2", "median of the Gaussian curvature"]
