"""Normals and albedo from images under known lights."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, DataError, Lights
from calibration import EstimateError, StackNoise
from calibration.radiance import check_linear
from processing.maps.normal_map import NormalMap, check_mask
from processing.stereo.frames import Frames
from processing.stereo.image_noise import NoiseLaw, law_of_images
from processing.stereo.light_model import LightModel, check_one_light_each
from processing.stereo.method import Estimator, method_name
from processing.stereo.solve import solve_maps
from processing.stereo.stereo_maps import StereoMaps
from rig import Notice, Progress, Severity, check_type, no_progress, short_repr
from rig.arrays import Bool, Float32, UInt16

# Share of the pixels of a mask that may have no normal, such as those in deep shadow.
_FEW = 0.01


@dataclass(frozen=True, eq=False)
class PhotometricStereoResult:
    """The result of photometric stereo.

    Parameters
    ----------
    normal_map
        Normals; the mask is the part of the input mask where they could be determined.
    albedo
        ``(H, W)`` float32, radiance under a light of intensity 1 that the surface faces, in the
        unit of the values; 0 outside the normal map's mask.
    residual
        ``(H, W)`` float32, root mean square of ``value - albedo * (l . n)`` over the samples used,
        in the same unit; 0 outside. Shadows and highlights are part of it.
    used
        ``(H, W)`` uint16, number of samples of each pixel, also if they were too few; 0 outside
        the input mask.
    warnings
        Whether pixels of the input mask have no normal.
    """

    normal_map: NormalMap
    albedo: Float32
    residual: Float32
    used: UInt16
    warnings: tuple[Notice, ...]

    __repr__ = short_repr


def photometric_stereo(
    values: npt.ArrayLike,
    lights: Lights,
    mask: Bool,
    *,
    method: str | Estimator = "best",
    points_mm: npt.ArrayLike | None = None,
    noise: StackNoise | None = None,
    camera: CameraModel | None = None,
    on_progress: Progress = no_progress,
) -> PhotometricStereoResult:
    """Estimate normals and albedo per pixel from images under known lights.

    Parameters
    ----------
    values
        ``(N, H, W)`` float32 linear radiance, one channel, already divided by the lights'
        intensities. Samples that are not finite (saturated, unmeasured) or masked are left
        out.
    lights
        The N lights in the order of the images.
    mask
        ``(H, W)`` bool, the object.
    method
        ``ls``: least squares over all samples, attached shadows included (Woodham, 1980).
        ``trimmed``: least squares without the darkest and the brightest fifth of the samples.
        ``cauchy``: least squares reweighted up to 10 times by ``1 / (1 + (r / s)^2)`` with s from
        the median of ``|r|``; shadows, highlights and other outliers lose their weight (Holland
        and Welsch, 1977).
        ``best``: the solution of a random triple of lights that agrees with most samples
        (Rousseeuw, 1984), then the mean of the normals that a family of reflectances gives: matte
        surfaces with GGX lobes of several widths or none (Walter et al., 2007), by how well each
        explains the samples. It is the most accurate on glossy and shadowed surfaces, and nearly
        as accurate as the others on matte ones. With fewer than 16 samples it is ``cauchy``.
        Or an estimator of your own, see `processing.stereo.Estimator`, or the name of one that is
        installed as an entry point of the group ``sgp.estimators``.
    points_mm
        ``(H, W, 3)`` surface points in the house frame, for lights with positions: the light
        vectors are those of `Lights.vectors_at`. Ignored for distant lights.
    noise
        Law of the noise of the images, `Stack.noise`. None if it is unknown: a law is then
        estimated from the differences between neighbouring pixels, except for ``ls``. Every method
        solves pixels whose residuals agree with the law again, by least squares weighted with the
        variances at the predicted signals. The errors of these pixels are those of the Cramer-Rao
        bound.
    camera
        Camera of the images, for the direction of view of ``best``; None for a distant camera in
        direction z.
    on_progress
        Receives the stage ``normals``, one step per pixel. An exception it raises ends the
        computation.

    Returns
    -------
    PhotometricStereoResult
        Normals that point away from the viewer (n_z < 0) are kept: in a perspective view a few of
        them are visible near outlines, and elsewhere they indicate wrong lights.

    Raises
    ------
    DataError
        If shapes or counts differ, also those of the noise, the mask is empty, or near lights have
        no points.
    EstimateError
        If there are fewer than 3 lights, the lights are in one plane, or no pixel can be
        determined.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Lights
    >>> from processing import photometric_stereo
    >>> lights = Lights(directions=[[1, 0, 1], [0, 1, 1], [-1, 0, 1], [0, -1, 1]])
    >>> normal = np.array([0.36, 0.48, 0.8])
    >>> values = np.tile(0.5 * lights.unit_directions @ normal, (4, 5, 1)).transpose(2, 0, 1)
    >>> result = photometric_stereo(values, lights, np.ones((4, 5), bool), method="ls")
    >>> result.normal_map.normals[0, 0].round(3), float(result.albedo[0, 0].round(3))
    (array([0.36, 0.48, 0.8 ], dtype=float32), 0.5)
    """
    check_linear("values", values)
    check_type("lights", lights, Lights, "Lights(directions)")
    name = method_name(method)
    stack = np.asarray(np.ma.filled(values, np.nan), np.float32)
    mask = _checked_mask(stack, lights, mask)
    model = LightModel(lights, points_mm, mask)
    model.check(mask)
    frames = Frames(stack)
    law: NoiseLaw | Float32 | None = None
    if noise is not None:
        law = NoiseLaw(noise, (len(stack), *mask.shape))
    elif name != "ls":
        law = law_of_images(frames, model, mask)
    maps = StereoMaps.empty(mask.shape)
    solve_maps(frames, model, mask, law, name, maps, camera, on_progress)
    return stereo_of(maps, mask, stack)


def stereo_of(maps: StereoMaps, mask: Bool, images: Iterable[Float32]) -> PhotometricStereoResult:
    """Return the result that maps contain; ``images`` show why if they contain none.

    Raises
    ------
    EstimateError
        If no pixel has a normal.
    """
    has_normal = maps.albedo > 0
    most_used = int(maps.used[mask].max(initial=0))
    return PhotometricStereoResult(
        normal_map=NormalMap.of_unit_vectors(maps.normals, has_normal),
        albedo=maps.albedo,
        residual=maps.residual,
        used=maps.used,
        warnings=check_solved(has_normal, mask, most_used, images),
    )


def check_solved(
    has_normal: Bool, mask: Bool, most_used: int, images: Iterable[Float32]
) -> tuple[Notice, ...]:
    """Return a notice if pixels of a mask have no normal.

    ``most_used`` is the largest number of samples that a pixel has.

    Raises
    ------
    EstimateError
        If no pixel has a normal; ``images`` show why.
    """
    if not has_normal.any():
        raise EstimateError(_why_nothing(most_used, mask, images))
    total = int(np.count_nonzero(mask))
    lost = total - int(np.count_nonzero(has_normal))
    text = (
        f"{lost} of {total} pixels of the mask {'has' if lost == 1 else 'have'} no normal: black, "
        "or too few usable samples"
    )
    notice = Notice("pixels-without-normal", text, severity=severity_of_loss(lost, total))
    return (notice,) if lost else ()


def severity_of_loss(lost: int, total: int) -> Severity:
    """Return how serious it is that some of all pixels have no normal."""
    return "warning" if lost > _FEW * total else "info"


def _checked_mask(stack: Float32, lights: Lights, mask: Bool) -> Bool:
    if stack.ndim != 3:
        raise DataError(
            f"photometric stereo requires a stack (N, H, W) of one channel, not {stack.shape}"
        )
    check_one_light_each(len(stack), lights)
    mask = check_mask("mask", mask, stack.shape[1:])
    if not mask.any():
        raise DataError("the mask is empty: there is no pixel to compute")
    return mask


def _why_nothing(most_used: int, mask: Bool, images: Iterable[Float32]) -> str:
    if most_used < 3:
        return "no pixel of the mask has 3 samples that are not saturated: record shorter exposures"
    if not any(np.nan_to_num(image[mask], posinf=0.0, neginf=0.0).any() for image in images):
        return "all images are black inside the mask: check the exposure and the mask"
    return "no pixel of the mask is reached by 3 lights that are not in one plane: check the lights"
