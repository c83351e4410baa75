"""The figures of `sgp detail`, which `sgp._metrics` assigns to its commands."""

from __future__ import annotations

from typing import Annotated, NotRequired

# Before Python 3.12, pydantic cannot check a `typing.TypedDict`.
from typing_extensions import TypedDict


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
            "mean angle between neighbouring normals across the seam of a local transfer, or "
            "of the detail across the borders of tiles; null without a seam",
        ]
    ]
    interior_step_deg: NotRequired[
        Annotated[
            float | None,
            "deg",
            "the same inside the region, or inside tiles; null if there is no interior",
        ]
    ]
    seam_ratio: NotRequired[
        Annotated[
            float | None,
            "1",
            "`seam_step_deg` / `interior_step_deg`; null if it is not defined",
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


class SynthesisMetrics(TypedDict):
    """Figures of a synthesised detail component relative to its exemplar.

    Of sheets larger than 2048 x 2048 pixels, the middle is measured.
    """

    detail_angle_deg: Annotated[float, "deg", "mean angle between the detail and z"]
    exemplar_angle_deg: Annotated[float, "deg", "the same of the exemplar"]
    slope_distance: Annotated[
        float | None,
        "1",
        "Wasserstein distance between the angles to z of sheet and exemplar, relative to the "
        "standard deviation of the exemplar's; null if all its angles are equal",
    ]
    spectrum_distance: Annotated[
        float | None,
        "Np",
        "mean absolute difference of the log power of the slopes of sheet and exemplar over 16 "
        "radial bands; null if no block of 32 x 32 pixels fits into both",
    ]
    exemplar_spectrum_distance: Annotated[
        float | None, "Np", "the same between two halves of the exemplar"
    ]
    repeat_score: Annotated[
        float | None,
        "up to 1",
        "largest normalised autocorrelation of the slopes at lags of at least a patch; null if "
        "the sheet is too small",
    ]
    exemplar_repeat_score: Annotated[float | None, "up to 1", "the same of the exemplar"]
    cut_step_deg: Annotated[
        float | None,
        "deg",
        "mean angle between neighbouring normals of different patches; null with one patch",
    ]
    inside_step_deg: Annotated[float | None, "deg", "the same inside patches"]
    shape_mae_deg: NotRequired[
        Annotated[
            float, "deg", "`--onto`: mean angle between the shape components of target and result"
        ]
    ]
    detail_mae_deg: NotRequired[
        Annotated[
            float,
            "deg",
            "`--onto`: mean angle between the synthesised detail and the detail of the result",
        ]
    ]
    detail_ssim: NotRequired[
        Annotated[float, "up to 1", "`--onto`: SSIM of the two details, over the mask"]
    ]
    detail_ssim_paper: NotRequired[
        Annotated[float, "up to 1", "`--onto`: the same in the paper's protocol"]
    ]
    compressed_share: NotRequired[
        Annotated[
            float,
            "1",
            "`--onto`: share of the pixels in patches that are smaller, since the exemplar has no "
            "room for their footprints",
        ]
    ]


class FillMetrics(TypedDict):
    """Figures of a map whose holes were filled."""

    pixels: Annotated[int, "px", "pixels with a normal"]
    filled_pixels: Annotated[int, "px", "pixels in holes, all invented"]
    detail_angle_deg: Annotated[float, "deg", "mean angle between the detail and z in the holes"]
    surroundings_angle_deg: Annotated[float, "deg", "the same in the surroundings that were used"]
    seam_step_deg: Annotated[
        float, "deg", "mean angle between neighbouring normals across the rims of the holes"
    ]
    interior_step_deg: Annotated[
        float | None, "deg", "the same inside the holes; null if they have no interior"
    ]
    seam_ratio: Annotated[float | None, "1", "`seam_step_deg` / `interior_step_deg`"]


class SuperresMetrics(TypedDict):
    """Figures of a normal map that was enlarged."""

    width: Annotated[int, "px", "width of the result"]
    height: Annotated[int, "px", "height of the result"]
    pixels: Annotated[int, "px", "pixels with a normal"]
    invented_share: Annotated[
        float,
        "0..1",
        "share of the detail that the network added: its mean square, relative to its sum with "
        "that of the detail of an interpolation",
    ]
    added_deg: Annotated[float, "deg", "mean angle between the result and an interpolation"]
    normal_sigma_deg: Annotated[
        float | None,
        "deg",
        "median of the predicted standard deviations of the normals; null for bicubic "
        "interpolation",
    ]
    model_sha256: Annotated[
        str | None, "", "hash of the network's file; null for bicubic interpolation"
    ]
    pixel_mm: NotRequired[
        Annotated[float, "mm", "size of a pixel of the result, if that of the given map is known"]
    ]


class TrainMetrics(TypedDict):
    """Figures of the training of a network."""

    steps: Annotated[int, "", "steps of the training"]
    parameters: Annotated[int, "", "weights of the network"]
    bicubic_mae_deg: Annotated[
        float, "deg", "mean angular error of bicubic interpolation on held-out surfaces"
    ]
    network_mae_deg: Annotated[float, "deg", "the same of the network"]
    actual_over_predicted: Annotated[
        list[float],
        "1",
        "actual over predicted deviation of the network's normals, for each tenth of the pixels in "
        "order of the prediction; 1 is best",
    ]
