"""Reflectance models: the share of the light at a point that is reflected toward the camera.

A reflectance here is ``pi f_r``, where f_r is the BRDF. It is 1 for white Lambertian paint, so that
radiance is reflectance times irradiance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from rig.arrays import Float32, Float64, Int8, Int64
from rig.kernels import PART
from simulator.shapes.ranges import check_within

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

_LAMBERT, _OREN_NAYAR, _GGX = 0, 1, 2
BLOCK = 1024  # points of a block
# Smallest cosine to the camera: normals interpolated over a mesh may face away from the camera
# slightly. The lobes are close to their limit here.
_GRAZING = 1e-3


@dataclass(frozen=True)
class Lambert:
    """Ideal diffuse paint: the reflectance is the albedo in every direction."""

    @property
    def lobes(self) -> tuple[int, float, float]:
        """Kind and its two parameters, for the kernels."""
        return _LAMBERT, 0.0, 0.0


@dataclass(frozen=True)
class OrenNayar:
    """Rough diffuse paint: clay, plaster, cloth.

    The qualitative model of Oren and Nayar, "Generalization of Lambert's reflectance model", 1994,
    equation 30, without interreflections. At grazing angles the published model reflects up to
    1.5 % more light than it receives.

    Parameters
    ----------
    sigma_deg
        Standard deviation of the slope angles, 0 (Lambertian) to 90 degrees.

    Raises
    ------
    DataError
        If sigma_deg is out of range.
    """

    sigma_deg: float = 20.0

    def __post_init__(self) -> None:
        check_within("OrenNayar", 0, 90, sigma_deg=self.sigma_deg)

    @property
    def lobes(self) -> tuple[int, float, float]:
        """Kind and its two parameters A and B, for the kernels."""
        squared = math.radians(self.sigma_deg) ** 2
        return _OREN_NAYAR, 1 - 0.5 * squared / (squared + 0.33), 0.45 * squared / (squared + 0.09)


@dataclass(frozen=True)
class Ggx:
    """Diffuse paint under a glossy coat.

    The coat is the microfacet model with the GGX distribution and Smith's height-correlated
    masking (Walter et al., 2007; Heitz, 2014) and Schlick's Fresnel term F. The albedo is
    multiplied by the transmission of the coat in both directions,
    ``(1 - F(light)) (1 - F(camera))``.

    Parameters
    ----------
    roughness
        Width alpha of the distribution, 0.02 to 1; the smaller, the sharper the gloss. The
        reflection of an LED in a smoother surface is smaller than a pixel.
    f0
        Share of the light that is mirrored at normal incidence, 0 to 1: 0.04 for lacquer, above
        0.5 for metal.

    Raises
    ------
    DataError
        If a parameter is out of range.
    """

    roughness: float = 0.3
    f0: float = 0.04

    def __post_init__(self) -> None:
        check_within("Ggx", 0.02, 1, roughness=self.roughness)
        check_within("Ggx", 0, 1, f0=self.f0)

    @property
    def lobes(self) -> tuple[int, float, float]:
        """Kind and its two parameters, for the kernels."""
        return _GGX, self.roughness, self.f0


Material = Lambert | OrenNayar | Ggx


def reflectance(
    material: Material,
    albedo: npt.ArrayLike,
    normals: npt.ArrayLike,
    toward_light: npt.ArrayLike,
    toward_eye: npt.ArrayLike,
) -> Float64:
    """Return ``pi f_r`` of points.

    Parameters
    ----------
    material
        Material of all points.
    albedo
        ``(...,)`` albedo of the diffuse part.
    normals, toward_light, toward_eye
        ``(..., 3)`` unit vectors; light and camera are on the outer side of the surface.

    Returns
    -------
    Array
        ``(...,)`` reflectance, 0 where the light is behind the surface.
    """
    n, to_light, to_eye = (np.asarray(v, np.float64) for v in (normals, toward_light, toward_eye))
    cosines = np.broadcast_arrays(
        np.asarray(albedo, np.float64),
        (n * to_light).sum(-1),
        (n * to_eye).sum(-1),
        (to_light * to_eye).sum(-1),
    )
    out = np.zeros(cosines[0].shape)
    painted, light, eye, between = (np.ascontiguousarray(v).ravel() for v in cosines)
    kind, first, second = material.lobes
    _reflectance(kind, first, second, painted, light, eye, between, out.reshape(-1))
    return out


@numba.njit(**PART)
def _lobes(
    kind: float, first: float, second: float, light: float, eye: float, between: float
) -> tuple[float, float]:
    """Return the factor of the albedo and the specular term, from three cosines."""
    if kind == _OREN_NAYAR:
        # With alpha the larger and beta the smaller angle to the normal,
        # cos(phi_i - phi_r) sin(alpha) tan(beta) = (l.v - (n.l)(n.v)) / cos(beta).
        along = max(between - light * eye, 0.0)
        return first + second * along / max(light, eye), 0.0
    if kind == _GGX:
        a2 = first * first
        half = math.sqrt(max(2.0 + 2.0 * between, 1e-12))
        across = (light + eye) / half
        dip = across * across * (a2 - 1.0) + 1.0
        masked = light * math.sqrt(eye * eye * (1.0 - a2) + a2)
        masked += eye * math.sqrt(light * light * (1.0 - a2) + a2)
        mirror = second + (1.0 - second) * (1.0 - min(half / 2.0, 1.0)) ** 5
        passed = (1.0 - second) * (1.0 - (1.0 - min(light, 1.0)) ** 5)
        passed *= (1.0 - second) * (1.0 - (1.0 - min(eye, 1.0)) ** 5)
        return passed, mirror * a2 / (dip * dip) * 0.5 / masked
    return 1.0, 0.0


@numba.njit(cache=True)
def _reflectance(
    kind: float,
    first: float,
    second: float,
    albedo: Float64,
    light: Float64,
    eye: Float64,
    between: Float64,
    out: Float64,
) -> None:
    for i in range(len(out)):
        if light[i] > 0.0:
            factor, added = _lobes(kind, first, second, light[i], max(eye[i], _GRAZING), between[i])
            out[i] = albedo[i] * factor + added


@numba.njit(nogil=True, cache=True)
def reflect(
    first: int,
    last: int,
    lobes: Float64,
    light: Float32,
    table: Float64,
    near: bool,
    intensities: Float64,
    points: Float64,
    normals: Float64,
    eyes: Float64,
    albedo: Float32,
    channel: Int8,
    material: Int64,
) -> None:
    """Convert irradiance to radiance in place.

    Parameters
    ----------
    first, last
        Blocks of points.
    lobes
        ``(M, 3)`` rows of the materials of the scene.
    light
        ``(N, n)`` irradiance of every light of intensity 1 at every point; overwritten with
        radiance.
    table, near
        Rows that begin with the lights' positions if ``near``, otherwise with unit directions.
    intensities
        ``(N, 3)`` intensities in red, green, blue.
    points, normals, eyes
        ``(n, 3)`` points in mm, unit normals, and unit vectors toward the camera.
    albedo
        ``(n, 3)`` albedo in red, green, blue.
    channel
        ``(n,)`` channel that the pixel sees, 0, 1 or 2; -1 for the mean of the three.
    material
        ``(n,)`` index of the material of each point; -1 is Lambertian.
    """
    count = light.shape[1]
    for block in range(first, last):
        for k in range(len(light)):
            for i in range(block * BLOCK, min((block + 1) * BLOCK, count)):
                if light[k, i] == 0.0:
                    continue
                c = channel[i]
                if c >= 0:
                    bare = intensities[k, c]
                    painted = bare * albedo[i, c]
                else:
                    bare = (intensities[k, 0] + intensities[k, 1] + intensities[k, 2]) / 3.0
                    painted = intensities[k, 0] * albedo[i, 0]
                    painted += intensities[k, 1] * albedo[i, 1]
                    painted = (painted + intensities[k, 2] * albedo[i, 2]) / 3.0
                m = material[i]
                if m < 0 or lobes[m, 0] == _LAMBERT:
                    light[k, i] *= painted
                    continue
                lx, ly, lz = table[k, 0], table[k, 1], table[k, 2]
                if near:
                    lx, ly, lz = lx - points[i, 0], ly - points[i, 1], lz - points[i, 2]
                    r = math.sqrt(lx * lx + ly * ly + lz * lz)
                    lx, ly, lz = lx / r, ly / r, lz / r
                cosine = lx * normals[i, 0] + ly * normals[i, 1] + lz * normals[i, 2]
                eye = eyes[i, 0] * normals[i, 0] + eyes[i, 1] * normals[i, 1]
                eye += eyes[i, 2] * normals[i, 2]
                between = lx * eyes[i, 0] + ly * eyes[i, 1] + lz * eyes[i, 2]
                factor, added = _lobes(
                    lobes[m, 0], lobes[m, 1], lobes[m, 2], cosine, max(eye, _GRAZING), between
                )
                light[k, i] *= painted * factor + bare * added
