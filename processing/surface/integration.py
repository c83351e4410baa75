"""Integration of a normal map to a height map."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from acquisition import CameraModel, DataError, MapRows
from calibration import EstimateError
from processing.maps.mask import bounding_box
from processing.maps.normal_map import NormalMap, check_normal_map
from processing.surface.anchors import anchored, anchors, doubts_of_prior, drift_notice
from processing.surface.chord_rule import ChordRule
from processing.surface.consistency import StepAngles, consistency_warning, some_steps
from processing.surface.edge_certainty import certainties, variances
from processing.surface.grid_graph import divergence, label_parts
from processing.surface.guesses import Guesses
from processing.surface.height_errors import simulate_errors
from processing.surface.height_map import HeightMap
from processing.surface.integrability_test import integrability
from processing.surface.jumps import LEAST_SUSPECTS, SHARPNESS, JumpProblem
from processing.surface.multigrid import solve
from processing.surface.prior import HeightPrior
from processing.surface.scale import check_view, nothing_faces, placed, scale_of
from processing.surface.surface_notices import doubts_of_parts, doubts_of_solution
from rig import Progress, no_progress
from rig.arrays import Bool, Float32


def integrate(
    normal_map: NormalMap,
    *,
    camera: CameraModel | None = None,
    pixel_mm: float | None = None,
    depth_mm: Float32 | None = None,
    sigma_deg: Float32 | None = None,
    common_sigma_deg: Float32 | float | None = None,
    weighted: bool = True,
    prior: HeightPrior | None = None,
    discontinuity: bool | None = None,
    k: float = SHARPNESS,
    height_errors: bool = False,
    on_progress: Progress = no_progress,
) -> HeightMap:
    """Integrate a normal map into a height map by weighted least squares on its mask.

    The chord rule gives a height step for each pair of neighbouring pixels inside the mask (see
    `processing.surface.chord_rule`). The surface that fits all steps best is the solution of a
    Poisson problem on the mask, computed by multigrid-preconditioned conjugate gradients.

    Parameters
    ----------
    normal_map
        The normals. Nothing is assumed outside its mask.
    camera
        A perspective camera of the same image size; without a camera the view is orthographic.
    pixel_mm
        Distance between neighbouring pixels on the object. If the camera has no working distance,
        it is computed from this. Without any scale the result is in pixels: a perspective surface
        then has a mean depth of one focal length.
    depth_mm
        ``(H, W)`` approximate depth, from a camera with a working distance, or, without a camera
        and with ``pixel_mm``, from the plane of height 0, so that depths are minus heights. The
        mean depth of each part is that of these values.
    sigma_deg
        ``(H, W)`` standard deviations of the normals in degrees, as `NormalUncertainty.sigma_deg`:
        edges count by their reciprocals. A normal whose deviation is NaN counts as the
        least certain one. Default: all normals are equally certain.
    common_sigma_deg
        The part of ``sigma_deg`` that all pixels have in common, as
        `NormalUncertainty.common_sigma_deg`, or one value for all. It bends and tilts the surface,
        and only serves for the errors of the heights. NaN counts as 0. Default: errors of pixels
        are independent.
    weighted
        Whether edges count by ``sigma_deg``. If not, it only serves for the errors of the heights.
    prior
        Heights that are known from elsewhere, in the unit of the surface; with a camera, above the
        working plane. The surface minimises the squared errors of steps and of these heights, each
        relative to its variance; without ``sigma_deg``, normals have deviations of 1 degree. A
        small deviation fixes a height.
    discontinuity
        Whether the surface may jump in depth, where one part hides another (see
        `processing.surface.jumps`); `HeightMap.jumps` says where. Default: if the normals show it
        (see `processing.surface.jump_evidence`), and the smooth surface contradicts more of them.
    k
        How small the jumps are that count, in 1/px^2: a step of ``1 / sqrt(k)`` pixels begins to be
        one.
    height_errors
        With ``sigma_deg``, also compute the standard deviations of the heights, by integrating
        24 maps of normals with simulated errors (`HeightMap.uncertainty`).
    on_progress
        Receives the stages ``integrating``, in percent, and ``errors of heights``.

    Returns
    -------
    HeightMap
        The surface. The mean of each connected part without a prior is fixed: height 0
        (orthographic), or depth equal to the working distance (perspective) or that of
        ``depth_mm``. Pixels without edges,
        which are isolated or grazing, are not in its mask, and a warning reports them.

    Raises
    ------
    DataError
        If the camera has another image size, the pixel size or ``k`` is not positive, both a pixel
        size and a working distance are given, deviations or prior do not fit, no height of the
        prior is on the surface, or errors of heights are requested and no deviation is known.
    EstimateError
        If no two neighbouring normals face the camera, or the range of depths is implausible.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, integrate
    >>> x = np.tile(np.arange(6.0), (4, 1))
    >>> slope = NormalMap.from_vectors(np.dstack([0 * x - 1, 0 * x, 0 * x + 1]))  # 45 degrees
    >>> surface = integrate(slope, pixel_mm=0.5)
    >>> surface
    HeightMap(float32[4, 6] in mm, pixel size 0.5 mm)
    >>> surface.height[0].round(3)
    array([-1.25, -0.75, -0.25,  0.25,  0.75,  1.25], dtype=float32)
    """
    check_normal_map("normal_map", normal_map)
    scale = scale_of(camera, pixel_mm)
    if not (math.isfinite(k) and k > 0):
        raise DataError(f"a sharpness k of {k} is not positive: 4 is a good value")
    check_view(normal_map.mask, camera, pixel_mm, depth_mm)
    if prior is not None and prior.height.shape != normal_map.size:
        raise DataError(
            f"a prior of shape {prior.height.shape} does not fit a normal map of shape "
            f"{normal_map.size}"
        )
    if sigma_deg is not None:
        sigma_deg = np.ma.filled(sigma_deg, np.nan)
    rows_of, variance = variances(sigma_deg, normal_map.mask)
    relative: Float32 | None = None if rows_of is None else rows_of[:]
    if height_errors and relative is None:
        raise DataError("errors of heights require standard deviations of the normals")
    window = bounding_box(normal_map.mask)
    common = _common(common_sigma_deg, normal_map.size)[window]
    # A kernel is compiled for each layout of its arguments: all windows have the same one.
    normals = np.ascontiguousarray(normal_map.normals[window])
    inside = np.ascontiguousarray(normal_map.mask[window])
    chords = ChordRule(window, camera)
    right, down, step_right, step_down = chords.edges(normals, inside)
    labels, count = label_parts(right, down)
    if count == 0:
        raise _nothing_to_integrate(inside, normal_map.size)
    steps = step_right, step_down
    held = None if prior is None else anchors(prior, labels, window, variance, scale)
    weights, factors = (right, down), None
    if relative is not None and weighted:
        factors = certainties(relative[window])
        weights = right * factors[0], down * factors[1]
    problem = None
    shape = integrability(normals, inside)
    # Normals with wrong axes contradict each other everywhere.
    if discontinuity or (discontinuity is None and shape.axes == "right"):
        least = 0.0 if discontinuity else LEAST_SUSPECTS
        edges = (right, down, *steps)
        problem = JumpProblem.of(normals, inside, chords, edges, k=k, factors=factors, least=least)
        del edges
    chords.correct(normals, (right, down), steps)
    sampled = some_steps(right, down, *steps)
    b = divergence(*weights, *steps)
    # What is large and not needed any longer does not add to the memory of the solver.
    if not height_errors:
        del normals
    del chords, right, down, step_right, step_down, steps
    jumps = free = drift = None
    used = held
    if held is not None or not discontinuity:
        solution = solve(*weights, b, on_progress=on_progress)
    del b
    if held is not None:
        solution, free, used, drift = anchored(weights, solution, labels, labels, held)
    if problem is not None:
        jumping, jumps, own_weights = replace(problem, known=held).solved(on_progress)
        if held is not None:
            apart = np.pad(jumps.pieces, 1, constant_values=-1)
            around = anchored(own_weights, jumping, labels, apart, held)
            jumping = around[0]
        if discontinuity or problem.improves(jumping.u, solution.u, held):
            solution, weights = jumping, own_weights
            jumps = jumps.placed(window, normal_map.size)
            if held is not None:
                _, free, used, drift = around
        else:
            jumps = None
    del problem
    parts = np.full(normal_map.size, -1, np.int32)
    parts[window] = labels[1:-1, 1:-1]
    mask = parts >= 0
    members = parts[mask]
    known = np.zeros(count, bool)
    if used is not None:
        known[labels[used.weights > 0]] = True
    near = None if depth_mm is None else depth_mm[mask].astype(np.float64)
    found = placed(solution.u[labels >= 0], members, near, known, scale)
    height = np.full(normal_map.size, np.nan, np.float32)
    maps: dict[str, MapRows] = {"height": height, "parts": parts}
    depth: Float32 | None = None
    if scale.distance is None:
        height[mask] = found
    else:
        maps["depth"] = depth = height.copy()
        depth[mask] = found
        height[mask] = scale.distance - found
    uncertainty = None
    if height_errors and relative is not None:
        rule = ChordRule(window, camera, smooth=jumps is None)
        right, down, *own_steps = rule.edges(normals, inside)
        own = own_steps[0], own_steps[1]
        guesses = None
        if jumps is not None:
            found_known = None if prior is None else prior.known[window]
            pieces = Guesses.of(jumps.pieces[window], parts[window], found_known)
            guessed = pieces.of_piece[jumps.pieces[window]]
            guesses = guessed, pieces.sigma(guessed, solution.u, (right, down), own)
        uncertainty = simulate_errors(
            normals,
            inside,
            rule,
            own,
            weights,
            labels,
            factor=scale.pixel_size if depth is None else -depth[window],
            variances=variance * relative[window],
            common_deg=common,
            variance=variance,
            held=used,
            drift=None if drift is None else drift[0],
            guesses=guesses,
            on_progress=on_progress,
        ).placed(window, normal_map.size)
    isolated = int(np.count_nonzero(normal_map.mask & ~mask))
    slope = scale.step_px if scale.distance is None else -scale.step_px
    angles = StepAngles.between(slope * sampled.steps, slope * sampled.of(solution.u))
    notices = [
        *doubts_of_parts(parts, isolated, jumps, None if prior is None else prior.known),
        *doubts_of_solution(solution),
        *consistency_warning(angles, shape, smooth=jumps is None),
    ]
    if prior is not None and used is not None and free is not None:
        counts = np.zeros_like(mask)
        counts[window] = used.weights[1:-1, 1:-1] > 0
        notices += doubts_of_prior(prior, height, scale.unit, used, counts, free)
        if drift is not None:
            notices.append(drift_notice(drift[1], labels, scale))
    return HeightMap(
        maps=maps,
        mask=mask,
        unit=scale.unit,
        pixel_size=scale.pixel_size,
        camera=camera,
        iterations=solution.iterations,
        relative_residual=solution.relative_residual,
        warnings=tuple(notices),
        disagreement_deg=angles.median_deg,
        curl=shape.curl,
        jumps=jumps,
        uncertainty=uncertainty,
    )


def _common(common_sigma_deg: Float32 | float | None, size: tuple[int, int]) -> Float32:
    """Return the common part of the deviations as a map; 0 where it is not known.

    Raises
    ------
    DataError
        If the shapes differ, or a deviation is negative or infinite.
    """
    given = np.asarray(0 if common_sigma_deg is None else common_sigma_deg, np.float32)
    if given.shape not in ((), size):
        raise DataError(f"common deviations of shape {given.shape} do not fit normals of {size}")
    if (given < 0).any() or np.isinf(given).any():
        raise DataError("common deviations of normals are negative or infinite: give degrees")
    return np.broadcast_to(np.nan_to_num(given), size)


def _nothing_to_integrate(inside: Bool, size: tuple[int, int]) -> EstimateError:
    if not (inside[1:] & inside[:-1]).any() and not (inside[:, 1:] & inside[:, :-1]).any():
        return EstimateError(
            f"no two pixels of the normal map of {size[1]} x {size[0]} are neighbours, so there is "
            "nothing to integrate: use a larger map, or check its mask"
        )
    return nothing_faces()
