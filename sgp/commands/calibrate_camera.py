"""``sgp calibrate camera``: intrinsics from views of a calibration board."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import acquisition
import calibration
import rig
from sgp.calibrate import FoundViews, board_of, find_views, mean_image
from sgp.cli.console import with_progress
from sgp.cli.exit import UsageError
from sgp.cli.options import Gamma, Inputs, OptionalInput, Pixels, Positive, Real
from sgp.results import CameraMetrics, Result, claim_folder, complete_provenance, writes_folder
from sgp.stages import open_source

_RECORD = "calibration.json"
# Working distances that differ by more than this contradict each other.
_SAME = 0.02


@writes_folder(_RECORD)
def camera(
    source: Inputs,
    *,
    out: Path,
    board: OptionalInput = None,
    squares: str | None = None,
    square_mm: Positive | None = None,
    marker_mm: Positive | None = None,
    dictionary: str | None = None,
    working_plane: OptionalInput = None,
    height_mm: Real = 0.0,
    working_distance_mm: Positive | None = None,
    lens: str = "",
    focus_mm: Positive | None = None,
    gamma: Gamma = "auto",
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Calibrate the camera with views of a board from `sgp calibrate board`.

    Take about 15 images with the board tilted by 20 to 45 degrees in different directions, and with
    the board in every corner of the image. Do not change zoom, focus or aperture. An additional
    view of the board on the working plane gives the working distance.

    For example:

        sgp calibrate camera views/ --board board.json --out camera
        sgp calibrate camera shots --board b.json --working-plane p.png --out c

    Parameters
    ----------
    source
        Images, folders of images, or sessions. Each image is a view; the images of a session are
        averaged and are one view.
    out
        Folder to create. It gets camera.json, camera.yml for OpenCV, cameras.txt for COLMAP and
        the picture camera.png.
    board
        board.json of the board that was printed.
    squares
        Instead of --board: squares across and down, such as 11x8.
    square_mm
        Side of a square in mm as measured on the print; default: that of --board.
    marker_mm
        Instead of --board: side of a marker in mm; default: 3/4 of a square.
    dictionary
        Instead of --board: markers, such as 5x5_100; default: 4x4_250.
    working_plane
        Image or session with the board on the working plane; gives the working distance.
    height_mm
        With --working-plane: height of the printed side above the working plane in mm.
    working_distance_mm
        Working distance in mm, if it was measured otherwise; it is compared with the one from
        --working-plane.
    lens
        Name of the lens, to be noted in camera.json; default: that of the session.
    focus_mm
        Distance to which the lens is focused, to be noted in camera.json.
    gamma
        Transfer curve of the images: auto, srgb, linear, an exponent such as 2.2, or a file with a
        table; see `sgp normals --help`.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Replace the files of an earlier result.
    """
    if working_plane is None and height_mm:
        raise UsageError("--height-mm is the height of the board of --working-plane: give it too")
    sheet = board_of(board, squares, square_mm, marker_mm, dictionary)
    found = find_views(source, sheet, gamma=gamma, max_pixels=max_pixels)
    estimate = _calibrated(found)
    plane, plane_files = _plane(working_plane, sheet, estimate, height_mm, gamma, max_pixels)
    # The camera that the first session states, if one does.
    stated = next((one.camera for one in found.sources if one.camera is not None), None)
    model = estimate.camera if plane is None else plane.camera
    if plane is None:
        model = replace(model, working_distance_mm=working_distance_mm)
    model = replace(
        model,
        lens=lens or (stated.lens if stated else ""),
        focus_mm=focus_mm or (stated.focus_mm if stated else None),
    )
    result = _described(estimate, found, plane)
    result.warnings = [
        *found.notices,
        *estimate.warnings,
        *(() if plane is None else plane.warnings),
        *_scale_notices(plane, sheet, working_distance_mm, stated),
        *[n for one in found.sources[:1] for n in acquisition.source.lens_notices(one, model)],
    ]
    result.inputs = [*([board] if board else []), *found.files, *plane_files]
    _write(claim_folder(out, _RECORD), model, estimate, result, {"source": source, "board": sheet})
    return result


def _calibrated(found: FoundViews) -> calibration.CameraCalibration:
    try:
        return with_progress(calibration.calibrate_camera)(found.views)
    except calibration.EstimateError as error:
        unused = [notice for notice in found.notices if notice.code == "board-not-found"]
        if unused:
            error.add_note(f"{len(unused)} of {found.images} images were not used: {unused[0]}")
        raise


def _plane(
    path: Path | None,
    board: calibration.CharucoBoard,
    estimate: calibration.CameraCalibration,
    height_mm: float,
    gamma: str,
    max_pixels: int,
) -> tuple[calibration.camera.WorkingPlane | None, list[Path]]:
    if path is None:
        return None, []
    source, files = open_source(path, gamma=gamma, max_pixels=max_pixels)
    frames = [frame for frame in source.frames if frame.role == "light"]
    view = calibration.find_board(mean_image(source, frames), board, str(path))
    return calibration.camera.find_working_plane(estimate, view, height_mm=height_mm), files


def _scale_notices(
    plane: calibration.camera.WorkingPlane | None,
    board: calibration.CharucoBoard,
    given_mm: float | None,
    stated: acquisition.CameraModel | None,
) -> list[rig.Notice]:
    """Return a warning if the working distance contradicts a known one."""
    known_mm = given_mm or (stated.working_distance_mm if stated else None)
    measured_mm = None if plane is None else plane.camera.working_distance_mm
    if known_mm is None or measured_mm is None or abs(measured_mm / known_mm - 1) <= _SAME:
        return []
    square_mm = board.square_mm * known_mm / measured_mm
    text = (
        f"the board on the working plane is {measured_mm:.0f} mm away, but the known working "
        f"distance is {known_mm:g} mm: is a square {square_mm:.2f} mm instead of "
        f"{board.square_mm:g} mm?"
    )
    return [rig.Notice("board-scale-doubtful", text)]


def _described(
    estimate: calibration.CameraCalibration,
    found: FoundViews,
    plane: calibration.camera.WorkingPlane | None,
) -> Result:
    K, sigma = estimate.camera.K, estimate.sigma
    used = [one for one in estimate.views if one.used]
    metrics: CameraMetrics = {
        "images": found.images,
        "views": len(used),
        "focal_px": (float(K[0, 0]), float(K[1, 1])),
        "centre_px": (float(K[0, 2]), float(K[1, 2])),
        "distortion": estimate.camera.distortion.tolist(),
        "std": dict(sigma),
        "corner_std_px": estimate.sigma_px,
        "coverage": estimate.coverage,
        "bare_corners": list(estimate.bare_corners),
        "view_rms_px": {one.view.name: one.rms_px for one in estimate.views},
        "views_left_out": [one.view.name for one in estimate.views if not one.used],
    }
    worst = max(used, key=lambda one: one.rms_px)
    summary = [
        f"camera from {rig.pluralize(len(used), 'view')}: focal length {K[0, 0]:.2f} +- "
        f"{sigma['fx']:.2f} x {K[1, 1]:.2f} +- {sigma['fy']:.2f} px, centre ({K[0, 2]:.2f} +- "
        f"{sigma['cx']:.2f}, {K[1, 2]:.2f} +- {sigma['cy']:.2f}) px",
        _distortion_line(estimate),
        f"corners scatter by {estimate.sigma_px:.3f} px; {estimate.coverage:.0%} of the field "
        f"covered; worst view {worst.view.name}, {worst.rms_px:.3f} px rms",
    ]
    if plane is not None:
        distance_mm = plane.camera.working_distance_mm or 0.0
        metrics["working_distance_mm"] = distance_mm
        metrics["working_distance_std_mm"] = plane.sigma_mm
        metrics["mm_per_px"] = plane.mm_per_px
        metrics["working_plane_tilt_deg"] = plane.tilt_deg
        summary.append(
            f"working distance {distance_mm:.2f} +- {plane.sigma_mm:.2f} mm, "
            f"{plane.mm_per_px:.5f} mm per pixel"
        )
    return Result(metrics=metrics, summary=summary)


def _distortion_line(estimate: calibration.CameraCalibration) -> str:
    names = ("k1", "k2", "p1", "p2", "k3")
    values = dict(zip(names, estimate.camera.distortion.tolist(), strict=True))
    known = [
        f"{name} {values[name]:.4g} +- {estimate.sigma[name]:.2g}"
        for name in names
        if name in estimate.sigma
    ]
    zero = ", ".join(name for name in names if name not in estimate.sigma)
    parts = [", ".join(known)] if known else []
    parts += [f"{zero} not determined, 0"] if zero else []
    return f"distortion: {'; '.join(parts)}"


def _write(
    out: Path,
    model: acquisition.CameraModel,
    estimate: calibration.CameraCalibration,
    result: Result,
    parameters: dict[str, Any],
) -> None:
    from sgp.pictures import coverage_panel, reprojection_panel, views_panel, write_overview

    names = {
        "camera": "camera.json",
        "opencv": "camera.yml",
        "colmap": "cameras.txt",
        "picture": "camera.png",
    }
    result.outputs = {key: out / name for key, name in names.items()}
    made_by = complete_provenance("sgp calibrate camera", parameters, result)
    acquisition.write_camera(result.outputs["camera"], model, provenance=made_by)
    acquisition.write_camera(result.outputs["opencv"], model)
    acquisition.write_camera(result.outputs["colmap"], model)
    panels = [coverage_panel(estimate), reprojection_panel(estimate), views_panel(estimate)]
    write_overview(result.outputs["picture"], "", panels, columns=2)
