"""``sgp detail superres``: enlarge a normal map with a network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

import acquisition
import processing
import rig
from sgp.cli.exit import UsageError
from sgp.cli.options import Green, Input, Memory, OptionalInput, Pixels, Positive
from sgp.results import Result, claim_folder, records_of, writes_folder
from sgp.stages import (
    MAPS,
    Limit,
    MapInput,
    MapOptions,
    camera_notices,
    measure_superres,
    stage_maps,
    write_superres_maps,
    write_superres_picture,
)


@writes_folder("superres.json")
def superres(
    normals: Input,
    *,
    scale: Literal[2, 4],
    out: Path,
    method: processing.superres.SuperResolutionMethod | None = None,
    model: str | None = None,
    self_ensemble: Annotated[bool | None, Parameter(negative="--no-self-ensemble")] = None,
    sampling: processing.superres.PixelSampling | None = None,
    pixel_mm: Positive | None = None,
    camera: OptionalInput = None,
    green: Green = "up",
    maps: MapOptions = MAPS,
    memory: Memory | None = None,
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Enlarge a normal map; a network adds detail that is plausible, but not measured.

    The network predicts how wrong it is, and how wrong bicubic interpolation is. It counts less
    where it expects to be worse; smooth parts are interpolated.

    For example:

        sgp detail superres out/normals --scale 4 --out large
        sgp detail superres leather.png --scale 2 --self-ensemble --out large

    Parameters
    ----------
    normals
        Image of normals, or folder with normals.* and mask.png, such as a result.
    scale
        Factor of the resolution, 2 or 4.
    out
        Folder for normals.exr and normals.png, mask.png, normal_sigma_deg.exr (predicted standard
        deviations), invented.png (the whiter, the more of the detail was added by the network),
        superres.png, superres.json, and camera.json with --camera.
    method
        detail (the network enlarges the detail component), normals (it enlarges the normals
        themselves) or bicubic (no network); default: that of the network.
    model
        Network: the name of one that comes with the program, or a .onnx file with its description
        (.json) next to it; default: the one that comes with the program.
    self_ensemble
        Average the results of 8 mirrored and turned copies: more accurate, eight times the time;
        default: at scale 4.
    sampling
        area (each normal is the mean over its pixel, as a camera records it) or points (the normal
        at the centre of the pixel, as a projection or a rendering draws it); default: points if the
        record next to the map says that sgp project wrote it, otherwise area.
    pixel_mm
        Size of a pixel of the given map on the object in mm; superres.json states that of the
        result.
    camera
        File of the camera of the given map; the one of the result is written.
    green
        Direction of the green channel in an image file.
    maps
        Form of the PNG.
    memory
        Memory to use, such as 3G or 500M; default: half of what is free. Maps that do not fit are
        computed in bands of rows, in files in the output folder; the same command continues them
        if it was interrupted.
    max_pixels
        Refuse images with more pixels than this, before decoding them, and results with more than
        this and 200 million.
    force
        Write into an output folder that already contains files.
    """
    if method == "bicubic" and (model is not None or self_ensemble):
        raise UsageError("--method bicubic uses no network: leave out --model and --self-ensemble")
    if camera is not None and pixel_mm is not None:
        raise UsageError("--camera and its distance give the scale: leave --pixel-mm out")
    network = None
    if method != "bicubic":
        network = processing.superres.read_superres_model(model, scale, method)
    found = processing.find_normals(normals, max_pixels=max_pixels)
    doubts = [] if sampling or network is None else points_notices(found.files)
    points = any(doubt.code == "superres-points" for doubt in doubts)
    stage = processing.superres.SuperResolutionStage.of(
        scale,
        method=method,
        model=network,
        self_ensemble=self_ensemble,
        sampling=sampling or ("points" if points else "area"),
        max_pixels=max(max_pixels, rig.MAX_PIXELS),
    )
    view = None if camera is None else acquisition.read_camera(camera, found.size)
    limit = Limit(memory, out / "superres", force)
    given = MapInput(normals, green, max_pixels=max_pixels)
    files = [] if network is None else [network.path, network.path.with_suffix(".json")]
    with stage_maps(stage, [given], limit, files=files) as found_maps:
        made = processing.SuperResolution(found_maps.maps, stage)
        claim_folder(out, "superres.json")
        result = Result(warnings=[*found_maps.warnings, *doubts], inputs=[*found_maps.files])
        result.outputs = maps.write(out, made.maps["normals"], made.mask)
        result.outputs |= write_superres_maps(out, made)
        measure_superres(made, result)
        picture, low = result.file("picture", out / "superres.png"), found_maps.inputs[0]
        write_superres_picture(picture, normals.name, made, low)
    size = pixel_mm
    if camera is not None and view is not None:
        result.inputs.append(camera)
        result.warnings += camera_notices(camera, view)
        acquisition.write_camera(result.file("camera", out / "camera.json"), view.upscaled(scale))
        unit, step = processing.surface.surface_scale(view, None)
        size = step if unit == "mm" else None
    if size is not None:
        result.metrics = {**result.metrics, "pixel_mm": size / scale}
        result.summary.append(f"pixel          {size / scale:.4g} mm")
    if network is not None:
        result.inputs += files
        result.parameters = {
            "model": network.name,
            "method": network.domain,
            "sampling": stage.sampling,
            "self_ensemble": stage.self_ensemble,
        }
    return result


_PROJECT = "sgp project"


def points_notices(files: Sequence[Path]) -> list[rig.Notice]:
    """Name a map that has the normals at the centres of pixels, by the record next to it.

    The normals alone do not show it: means over pixels look like points of a smoother surface. A
    map without a record is named, too.
    """
    commands = {record.command for file in files for _, record in records_of(file)}
    where = str(files[0])
    if _PROJECT in commands:
        text = (
            f"{_PROJECT} draws the normals at the centres of the pixels: they are averaged over "
            "the pixels first"
        )
        return [rig.Notice("superres-points", text, where, "info")]
    if not commands:
        text = (
            "no record says what the normals are: they count as means over pixels, as a camera "
            "records them; for a rendering or a projection, give --sampling points"
        )
        return [rig.Notice("superres-means-assumed", text, where, "info")]
    return []
