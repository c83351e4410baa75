"""The figures of normals, components, surfaces and curvature; see `sgp.results.metrics`."""

from __future__ import annotations

from typing import Literal, NotRequired

# Before Python 3.12, pydantic cannot check a `typing.TypedDict`.
from typing_extensions import TypedDict


class QualityMetrics(TypedDict, total=False):
    """Agreement of images, lights and normals; records of earlier programs do not have them.

    Parameters
    ----------
    residual_relative : 0..1
        median over the object of the rms deviation of lit samples from the lights, relative to the
        signal
    consistency : 0..1
        the same deviation from combinations of three images, whatever the lights
    samples_used : 0..1
        share of the samples that are neither saturated nor in shadow
    curl : 0..1
        disagreement of the mixed derivatives of the normals: 0 for a surface, 1 for a mirrored one,
        0.7 for noise
    image_residuals : 1
        median deviation of each image from the lights, relative to the signal
    light_errors_deg : deg
        angle between each light and the one that the images show, if they do
    light_gains : 1
        brightness of each image relative to its light, in the same cases
    """

    residual_relative: float | None
    consistency: float | None
    samples_used: float | None
    curl: float | None
    image_residuals: list[float]
    light_errors_deg: list[float]
    light_gains: list[float]


class InspectMetrics(QualityMetrics):
    """Figures of an inspection.

    Parameters
    ----------
    images
        images that show light, each with its light
    lights
        `near` if the lights have positions
    pixels : px
        size of the mask
    """

    images: int
    lights: Literal["near", "distant"]
    pixels: int


class SampleShares(TypedDict):
    """Shares of the samples inside the mask; their sum is 1.

    Parameters
    ----------
    lit : 0..1
        agree with a matte surface
    attached : 0..1
        the surface faces away from the light
    cast : 0..1
        something blocks the light
    saturated : 0..1
        saturated in all exposures, or not measured
    outlier : 0..1
        contradict the lit ones: highlights, light from elsewhere
    missing : 0..1
        of lights that shine in another direction
    """

    lit: float
    attached: float
    cast: float
    saturated: float
    outlier: float
    missing: float


class NormalsMetrics(QualityMetrics):
    """Figures of an estimation of normals.

    Parameters
    ----------
    images
        images that were used, each with its light
    lights
        `near` if the lights have positions
    pixels : px
        size of the mask
    coverage : 0..1
        share of the mask that has a normal; with a ground truth, only pixels with a true normal
        count
    residual_rms : white level
        rms deviation of the images from the estimate, over the pixels with a normal; null if it
        exceeds the range of numbers
    normal_sigma_deg : deg
        median over the pixels of the standard deviations of the normals; null if they are not known
    normal_sigma_common_deg : deg
        median of the part of them that all pixels have in common: errors of the lights and of the
        mean height, and what the causes of the verdict do
    lens_blur_px : px
        standard deviation of the blur of the lens, if the detail of the normals shows it; otherwise
        0.7 counts
    noise_from
        where the law of the noise is from, on which the standard deviations rest
    neighbour_correlation : -1..1
        correlation between the residuals of each light and of the one nearest to it: about -0.1 for
        noise; above 0.1 the surface is not matte; null with fewer than 8 lights
    samples
        what the samples inside the mask show
    mae_deg : deg
        mean angle to the ground truth, if the source has one; a pixel without a normal counts as 90
    median_deg : deg
        median of the same angles
    mean_height_mm : mm
        lights with positions: mean height of the object above the plane
    mean_height_sigma_mm : mm
        standard deviation of this height, from the scatter of residuals between pixels and lights
        and from stated errors of positions; absent if the height was stated or found together with
        strengths of lights
    lowest_height_mm : mm
        height above the plane that 0.5 % of the object are below
    height_changes_mm : mm
        rms change of the heights in each step in which normals and heights were computed in turn
    excluded
        `--exclude auto`: images that were left out because others contradict them
    rescaled : 1
        `--exclude auto`: how many times as bright as stated the light of images is of which only
        the brightness is wrong; they were divided by it
    shifts_px : px
        `--align`: by how much the object is further right and down in images that were moved back
    strength_sigma : 1
        `--semi-calibrated`: median of the relative standard deviations of the strengths, with 1 %
        (7 % if the object is not matte) for the height if it was found with them
    light_distance_mm : mm
        `--light-distance-mm`: distance of the lights from the middle of the object
    light_distance_sigma_mm : mm
        standard deviation of this distance, if it was estimated
    ambient_level : 1
        `--ambient estimate`: constant light on a surface that faces the camera, relative to that
        of a light of mean intensity
    ambient_sigma : 1
        standard deviation of this light; it is part of those of the normals
    """

    images: int
    lights: Literal["near", "distant"]
    pixels: int
    coverage: float
    residual_rms: float | None
    normal_sigma_deg: NotRequired[float | None]
    normal_sigma_common_deg: NotRequired[float | None]
    lens_blur_px: NotRequired[float]
    noise_from: NotRequired[Literal["sensor", "repeats", "residuals", "unknown"]]
    neighbour_correlation: NotRequired[float | None]
    samples: NotRequired[SampleShares]
    mae_deg: NotRequired[float]
    median_deg: NotRequired[float]
    mean_height_mm: NotRequired[float]
    mean_height_sigma_mm: NotRequired[float]
    lowest_height_mm: NotRequired[float]
    height_changes_mm: NotRequired[list[float]]
    excluded: NotRequired[list[str]]
    rescaled: NotRequired[dict[str, float]]
    shifts_px: NotRequired[dict[str, list[float]]]
    strength_sigma: NotRequired[float]
    light_distance_mm: NotRequired[float]
    light_distance_sigma_mm: NotRequired[float]
    ambient_level: NotRequired[float]
    ambient_sigma: NotRequired[float]


class SeparationMetrics(TypedDict):
    """Figures of a separation into shape and detail.

    Parameters
    ----------
    separability_deg : deg
        mean angle between the shape component of the detail and z; 0 is best
    """

    separability_deg: float


class MeshMetrics(TypedDict, total=False):
    """Figures of meshes with fewer triangles than the surface.

    Parameters
    ----------
    triangles
        triangles of each mesh, if a number was requested
    deviation_rms : `unit`
        distance of such a mesh from the surface, rms
    deviation_largest : `unit`
        largest distance of such a mesh from the surface
    """

    triangles: int
    deviation_rms: float
    deviation_largest: float


class SurfaceMetrics(MeshMetrics):
    """Figures of a surface.

    Parameters
    ----------
    unit
        unit of heights; `px` if the scale is not known
    pixel_size : `unit`
        distance of neighbouring pixels; with a camera, at the working distance
    camera_distance : `unit`
        distance of a perspective camera from height 0, along its axis
    camera_axis_px : px
        column and row at which this axis meets the map
    height_range : `unit`
        highest minus lowest point
    vertices
        vertices of the surface, one for each pixel with a height
    parts
        connected parts
    iterations
        iterations of the solver
    disagreement_deg : deg
        median angle between the given normals and the normals of the surface
    curl : 0..1
        disagreement of the mixed derivatives of the normals: 0 for a surface, 1 for a mirrored one,
        0.7 for noise
    normal_residual_deg : deg
        mean angle between the given normals and those of the surface
    curl_deg : deg
        robust standard deviation of the curl of the normals, which is that of the normals if their
        errors are independent
    curl_excess : 1
        the same relative to the standard deviations of the normals: 1 for noise
    blocks
        `--memory`: blocks of rows in which the surface was solved
    block_rounds
        rounds in which the blocks were corrected by their neighbours
    block_error : `unit`
        estimated largest difference from the surface solved as a whole
    height_sigma : `unit`
        `--height-sigma`: median standard deviation of the heights, relative to the mean of their
        part or to the prior
    difference_distances_px : px
        `--height-sigma`: distances in rows and columns
    difference_sigma : `unit`
        standard deviations of differences in height at these distances
    prior_heights
        `--prior`: pixels of the surface whose height is known
    prior_rms : `unit`
        rms difference between the surface and these heights
    prior_sigma : `unit`
        rms of the standard deviations of these heights
    jumps
        if the surface jumps: pairs of neighbours between which the surface jumps
    pieces
        if the surface jumps: pieces that no reliable pair of neighbours connects
    settled
        if the surface jumps: whether the surface stood still in the last round
    """

    unit: Literal["mm", "px"]
    pixel_size: NotRequired[float]
    camera_distance: NotRequired[float]
    camera_axis_px: NotRequired[list[float]]
    height_range: float
    vertices: int
    parts: int
    iterations: int
    disagreement_deg: NotRequired[float]
    curl: NotRequired[float | None]
    normal_residual_deg: NotRequired[float]
    curl_deg: NotRequired[float]
    curl_excess: NotRequired[float]
    blocks: NotRequired[int]
    block_rounds: NotRequired[int]
    block_error: NotRequired[float]
    height_sigma: NotRequired[float]
    difference_distances_px: NotRequired[list[int]]
    difference_sigma: NotRequired[list[float]]
    prior_heights: NotRequired[int]
    prior_rms: NotRequired[float]
    prior_sigma: NotRequired[float]
    jumps: NotRequired[int]
    pieces: NotRequired[int]
    settled: NotRequired[bool]


class CurvatureMetrics(TypedDict):
    """Figures of a map of curvatures.

    Parameters
    ----------
    unit
        unit of lengths; `px` if the scale is not known
    pixels : px
        pixels with a curvature
    scale : `unit`
        standard deviation of the weights of the fits
    mean_median : 1/`unit`
        median of the mean curvature, positive where convex toward the camera
    mean_rms : 1/`unit`
        root mean square of the mean curvature
    gaussian_median : 1/`unit`^2
        median of the Gaussian curvature
    """

    unit: Literal["mm", "px"]
    pixels: int
    scale: float
    mean_median: float
    mean_rms: float
    gaussian_median: float
