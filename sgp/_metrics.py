"""The figures of each command: the `metrics` of its result and of its record.

Every figure has a type, a unit and a meaning; docs/result-format.md lists them. A figure that is
not required is only there in the cases that its meaning names. A figure that may be None may also
be NaN, and is null in files.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final, Literal

# Before Python 3.12, pydantic cannot check a `typing.TypedDict`.
from typing_extensions import TypedDict

from sgp._calibration_metrics import (
    BoardMetrics,
    CameraMetrics,
    FlatMetrics,
    IntensitiesMetrics,
    SensorMetrics,
    SpheresMetrics,
)
from sgp._comparison_metrics import CheckMetrics
from sgp._detail_metrics import (
    CombineMetrics,
    FillMetrics,
    PropertiesMetrics,
    SuperresMetrics,
    SynthesisMetrics,
    TrainMetrics,
    TransferMetrics,
)
from sgp._relight_metrics import RelightMetrics, RtiMetrics
from sgp._stage_metrics import (
    CurvatureMetrics,
    InspectMetrics,
    NormalsMetrics,
    SeparationMetrics,
    SurfaceMetrics,
)

# Of the record that a command leaves in its output folder: docs/result-format.md.
RECORD_FORMAT: Final = "sgp-result"
RECORD_VERSION: Final = 1


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
    normals_resolved_mae_deg: Annotated[
        float,
        "deg",
        "the same with respect to the true normals blurred as the lens blurs the images",
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


class ExportMetrics(TypedDict):
    """Figures of an export of a session."""

    images: Annotated[int, "", "images that were written"]
    values: Annotated[Literal["raw", "linear"], "", "values of the images, as in `--values`"]
    subtracted: Annotated[str, "", "what was subtracted from the frames"]
    black_level_dn: Annotated[float, "DN", "black level of the images"]
    white_level_dn: Annotated[float, "DN", "white level of the images"]
    exposures_us: Annotated[list[float], "µs", "exposure times of the images, shortest first"]


class BatchMetrics(TypedDict):
    """Figures of a batch."""

    sources: Annotated[int, "", "recordings that were given"]
    done: Annotated[int, "", "those with a result that is up to date"]
    failed: Annotated[int, "", "those without one"]
    computed: Annotated[int, "", "those that were computed by this run"]


class SimulateMetrics(TypedDict):
    """Figures of a simulated recording."""

    lights: Annotated[int, "", "lights of the scene"]
    width: Annotated[int, "px", "width of the images"]
    height: Annotated[int, "px", "height of the images"]
    exposures_us: Annotated[list[float], "µs", "exposure times"]
    pixels: Annotated[int, "px", "pixels of the object"]
    spheres: Annotated[int, "", "chrome spheres in the image"]
    seconds: Annotated[dict[str, float], "s", "duration of each stage"]


class ReportMetrics(TypedDict):
    """Figures of a report."""

    results: Annotated[int, "", "result folders on the page"]
    bytes: Annotated[int, "bytes", "size of the page"]
    reduction: Annotated[
        list[float], "", "pixels of each result for a pixel of the page, in rows and in columns"
    ]


class VerifyMetrics(TypedDict):
    """Figures of a comparison of results with their records."""

    records: Annotated[int, "", "records, and files that state what they were computed from"]
    files: Annotated[int, "", "files of results that were checked"]
    inputs: Annotated[int, "", "inputs that were compared with their hashes"]
    inputs_missing: Annotated[int, "", "inputs that are no longer there"]
    faults: Annotated[int, "", "files that are missing, damaged or changed"]


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
    "sgp compare": (CompareMetrics,),
    "sgp export": (RtiMetrics,),
    "sgp relight": (RelightMetrics,),
    "sgp capture export": (ExportMetrics,),
    "sgp calibrate spheres": (SpheresMetrics,),
    "sgp calibrate intensities": (IntensitiesMetrics,),
    "sgp calibrate flat": (FlatMetrics,),
    "sgp calibrate check": (CheckMetrics,),
    "sgp calibrate sensor": (SensorMetrics,),
    "sgp calibrate board": (BoardMetrics,),
    "sgp calibrate camera": (CameraMetrics,),
    "sgp simulate": (SimulateMetrics,),
    "sgp report": (ReportMetrics,),
    "sgp verify": (VerifyMetrics,),
}
