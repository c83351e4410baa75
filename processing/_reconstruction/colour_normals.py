"""Normals, error bars and gloss of images in colour."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from processing._reconstruction.colours import stereo_of_colours
from processing._reconstruction.error_bars import error_bars
from processing._reconstruction.examination import Examination
from processing._reconstruction.joint_colours import joint_stereo
from processing._reconstruction.solved_images import SolvedImages
from processing._reconstruction.specular import specular_residual
from processing._stereo.method import Method
from rig import Progress


def normals_of_colours(
    examined: Examination, method: Method, on_progress: Progress, *, joint: bool
) -> tuple[SolvedImages, npt.NDArray[np.float32]]:
    """Return the solution of images in colour, and the albedo ``(H, W, 3)``.

    ``joint`` selects `joint_stereo`; otherwise each colour is solved on its own.

    Raises
    ------
    EstimateError
        As `photometric_stereo`, or if no pixel is valid.
    """
    stack, lights, points_mm = examined.colours, examined.lights, examined.points_mm
    if stack is None:
        raise AssertionError("images in gray have no colours")
    of_colours = joint_stereo if joint else stereo_of_colours
    stereo, albedo = of_colours(
        stack.values,
        lights,
        examined.mask,
        method=method,
        points_mm=points_mm,
        noise=stack.noise,
        camera=examined.source.camera,
        on_progress=on_progress,
    )
    lost = stereo.warnings
    stereo, uncertainty, doubts = error_bars(
        stack,
        lights,
        examined.mask,
        stereo,
        albedo,
        points_mm,
        examined.near,
        examined.view,
        on_progress,
    )
    specular = specular_residual(
        stack.values, lights, stereo, points_mm=points_mm, noise=stack.noise
    )
    return SolvedImages(stereo, uncertainty, specular, (*lost, *doubts)), albedo
