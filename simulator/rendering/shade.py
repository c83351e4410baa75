"""Radiance of points under every light: fall-off, occlusion and reflectance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np

from acquisition import Lights
from rig import in_threads
from rig.arrays import Bool, Float32, Float64, Int8
from simulator.rendering.shadow import Occluders
from simulator.rendering.trace import Seen
from simulator.scene.lens import directions_across
from simulator.scene.reflectance import BLOCK, reflect
from simulator.scene.scene import Scene

_BLOCK = 1024
_GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))


@dataclass(frozen=True, eq=False)
class Shader:
    """Computes the light of points of one scene.

    Parameters
    ----------
    scene
        The scene.
    shadow_step_mm
        Step of the height grid that casts the object's shadow.
    """

    scene: Scene
    shadow_step_mm: float

    @cached_property
    def _lamps(self) -> Float64:
        return lamp_table(self.scene.lights)

    @cached_property
    def _parts(self) -> Float64:
        lights, count = self.scene.lights, self.scene.soft_shadow_samples
        return lamp_parts(lights, self.scene.led_radius_mm, count if lights.near else 1)

    @cached_property
    def occluders(self) -> Occluders:
        """What can be between a point and a light."""
        scene, caster = self.scene, None
        if scene.body is not None and scene.shadows:
            caster = scene.body.shadow_caster(self.shadow_step_mm)
        return Occluders.of(scene.clutter_table, caster, scene.sphere_table[:, :4])

    def shade(self, seen: Seen, albedo: Float32, channel: Int8) -> tuple[Float32, Float32, Bool]:
        """Return the radiance of points toward the camera.

        Parameters
        ----------
        seen
            The n points.
        albedo
            ``(n, 3)`` albedo in red, green, blue.
        channel
            ``(n,)`` channel that the pixel sees, 0, 1 or 2; -1 for the mean of the three.

        Returns
        -------
        lit
            ``(N, n)`` radiance under each light, 1 for a white surface under irradiance 1.
        ambient
            ``(n,)`` radiance under the room's light.
        dark
            ``(N, n)`` True at points that receive no light, or less than half of it.
        """
        scene, near = self.scene, self.scene.lights.near
        light = irradiance(self._lamps, seen.points_mm, seen.normals, near=near)
        dark = self.occluders.occlude(
            light, seen.points_mm, seen.normals, seen.direct, self._parts, near
        )
        albedo = albedo * np.where(seen.lost, 0.0, seen.weight).astype(np.float32)[:, None]
        intensities = np.asarray(scene.lights.intensities)
        self._reflect(light, slice(None), seen, albedo, channel)
        tinted = channel >= 0
        pick = np.arange(len(channel)), np.where(tinted, channel, 0)
        ambient = np.where(tinted, albedo[pick], albedo.mean(axis=1))
        # A sphere mirrors the dim surroundings where it mirrors neither board nor object.
        dim = scene.surroundings * np.where(seen.lost, seen.weight, 0.0)
        ambient = scene.ambient * (ambient + dim)
        if seen.lost.any():
            tint = np.where(tinted, intensities[:, pick[1]], scene.irradiance[:, None])
            light += (tint * dim).astype(np.float32)
        return light, ambient.astype(np.float32), dark

    def shade_partly(
        self, led: int, seen: Seen, albedo: Float32, channel: Int8, samples: Float64
    ) -> Float32:
        """Return the radiance of points that are partly in the shadow of one light.

        Parameters
        ----------
        led
            Index of the light.
        seen, albedo, channel
            The n points, as for `shade`; none of them seen via a sphere.
        samples
            ``(S, n, 3)`` points around each of them, for the lit share.

        Returns
        -------
        Values
            ``(n,)`` radiance, as from `shade`.
        """
        scene, one = self.scene, slice(led, led + 1)
        lamps, near = self._lamps[one], scene.lights.near
        light = irradiance(lamps, seen.points_mm, seen.normals, near=near)
        count = len(samples)
        visible = np.tile(light > 0, count).astype(np.float32)
        self.occluders.occlude(
            visible,
            samples.reshape(-1, 3),
            np.tile(seen.normals, (count, 1)),
            np.ones(visible.shape[1], np.bool_),
            self._parts[one],
            near,
        )
        light *= visible.reshape(count, -1).mean(axis=0)
        self._reflect(light, one, seen, albedo, channel)
        shaded: Float32 = light[0]
        return shaded

    def _reflect(
        self,
        light: Float32,
        lamps: slice,
        seen: Seen,
        albedo: Float32,
        channel: Int8,
    ) -> None:
        """Convert the irradiance from some lamps to radiance, in place."""
        scene = self.scene
        materials = (scene.material, *(item.material for item in scene.clutter))
        # The object's material is 0, then those of the clutter follow. Points of the board, and
        # all that a sphere mirrors, count as Lambertian (-1).
        index = np.where(seen.item >= 0, seen.item + 1, np.where(seen.on_object, 0, -1))
        in_threads(
            reflect,
            -(-light.shape[1] // BLOCK),
            np.array([each.lobes for each in materials], np.float64),
            light,
            self._lamps[lamps],
            scene.lights.near,
            np.asarray(scene.lights.intensities)[lamps],
            seen.points_mm,
            seen.normals,
            scene.lens.eye_to(seen.points_mm),
            albedo,
            channel,
            np.where(seen.direct, index, -1),
        )


def lamp_table(lights: Lights) -> Float64:
    """Return ``(N, 8)``: position or unit direction, axis, mu, and factor to 1 at the origin."""
    places = np.asarray(lights.positions_mm if lights.near else lights.directions)
    axes, mu = np.asarray(lights.axes), np.asarray(lights.mu)
    scale = np.ones(len(lights))
    if lights.near:
        squared = (places**2).sum(axis=1)
        cosine = -(places * axes).sum(axis=1) / np.sqrt(squared)
        scale = squared / cosine**mu
    return np.column_stack([places, axes, mu, scale])


def lamp_parts(lights: Lights, radius_mm: float, count: int) -> Float64:
    """Return ``(N, count, 3)`` positions that are spread uniformly over each lamp's disc.

    A single position is the lamp's centre, or a distant light's direction. More positions are on
    Vogel's spiral.
    """
    places = np.asarray(lights.positions_mm if lights.near else lights.directions)
    if count == 1:
        return places[:, None].copy()
    first, second = directions_across(np.asarray(lights.axes))
    index = np.arange(count)
    reach = radius_mm * np.sqrt((index + 0.5) / count)
    u, v = reach * np.cos(index * _GOLDEN_ANGLE), reach * np.sin(index * _GOLDEN_ANGLE)
    return np.asarray(places[:, None] + u[:, None] * first[:, None] + v[:, None] * second[:, None])


def irradiance(lamps: Float64, points_mm: Float64, normals: Float64, *, near: bool) -> Float32:
    """Return the irradiance of points from lamps of intensity 1 without occlusion.

    The irradiance from a near lamp is ``max(cos t, 0)^mu / r^2 max(n . l, 0)``, with distance r and
    direction l from the point to the lamp and the angle t to the lamp's axis (Queau et al.,
    LED-based photometric stereo, 2018). It is scaled to 1 on a surface at the origin that faces the
    lamp. The irradiance from a distant lamp is ``max(n . l, 0)``.

    Parameters
    ----------
    lamps
        ``(N, 8)``, see `lamp_table`.
    points_mm, normals
        ``(n, 3)`` points and unit normals.
    near
        Whether ``lamps`` are near.

    Returns
    -------
    Values
        ``(N, n)`` irradiance.
    """
    out = np.zeros((len(lamps), len(points_mm)), np.float32)
    blocks = -(-len(points_mm) // _BLOCK)
    in_threads(_irradiance, blocks, lamps, near, points_mm, normals, out)
    return out


@numba.njit(nogil=True, cache=True)
def _irradiance(
    first: int,
    last: int,
    lamps: Float64,
    near: bool,
    points: Float64,
    normals: Float64,
    out: Float32,
) -> None:
    count = out.shape[1]
    for block in range(first, last):
        for k in range(len(lamps)):
            dx, dy, dz = lamps[k, 0], lamps[k, 1], lamps[k, 2]
            ax, ay, az = lamps[k, 3], lamps[k, 4], lamps[k, 5]
            mu, scale = np.float32(lamps[k, 6]), lamps[k, 7]
            for i in range(block * _BLOCK, min((block + 1) * _BLOCK, count)):
                if near:
                    dx = lamps[k, 0] - points[i, 0]
                    dy = lamps[k, 1] - points[i, 1]
                    dz = lamps[k, 2] - points[i, 2]
                facing = dx * normals[i, 0] + dy * normals[i, 1] + dz * normals[i, 2]
                if facing <= 0.0:
                    continue
                if not near:
                    out[k, i] = facing
                    continue
                ahead = -(dx * ax + dy * ay + dz * az)
                if ahead <= 0.0:
                    continue
                r2 = dx * dx + dy * dy + dz * dz
                r = math.sqrt(r2)
                # The power is the slowest part; single precision keeps its error below 1e-6.
                out[k, i] = scale * facing / (r2 * r) * np.float32(ahead / r) ** mu
