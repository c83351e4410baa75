"""Mirror spheres computed from first principles, without code from the package under test."""

from __future__ import annotations

import importlib
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from acquisition import CameraModel, read_source
from calibration.spheres import fit_ellipse
from tests.real_data import DATA


@dataclass(frozen=True)
class Bench:
    """Pinhole camera at (0, 0, distance) that looks down, implemented independently."""

    focal_px: float = 5000.0
    distance_mm: float = 600.0
    width: int = 2448
    height: int = 2048

    @property
    def eye(self):
        return np.array([0.0, 0.0, self.distance_mm])

    @property
    def camera(self):
        cx, cy = (self.width - 1) / 2, (self.height - 1) / 2
        K = np.array([[self.focal_px, 0, cx], [0, self.focal_px, cy], [0, 0, 1]])
        return CameraModel(K, self.width, self.height, self.distance_mm)

    def project(self, point):
        x, y, z = point
        depth = self.distance_mm - z
        return np.array(
            [
                (self.width - 1) / 2 + self.focal_px * x / depth,
                (self.height - 1) / 2 - self.focal_px * y / depth,
            ]
        )

    def outline(self, centre, radius, count=400):
        """Return the pixels of the points at which rays from the eye touch the sphere."""
        axis = np.asarray(centre, float) - self.eye
        distance = np.linalg.norm(axis)
        axis = axis / distance
        first = np.cross(axis, [0.0, 1.0, 0.0])
        first /= np.linalg.norm(first)
        second = np.cross(axis, first)
        # Circle of contact: the polar plane is at distance - radius^2 / distance from the eye.
        along = distance - radius**2 / distance
        ring = radius * np.sqrt(1 - (radius / distance) ** 2)
        angles = np.arange(count) * 2 * np.pi / count
        return np.array(
            [
                self.project(
                    self.eye + along * axis + ring * (np.cos(t) * first + np.sin(t) * second)
                )
                for t in angles
            ]
        )

    def highlight(self, centre, radius, light):
        """Return the pixel of a light's highlight on a sphere, the root of Alhazen's problem."""
        centre, light = np.asarray(centre, float), np.asarray(light, float)
        e = (self.eye - centre) / np.linalg.norm(self.eye - centre)
        w = light - centre
        w = w - (w @ e) * e
        w /= np.linalg.norm(w)

        def imbalance(angle):
            normal = np.cos(angle) * e + np.sin(angle) * w
            point = centre + radius * normal
            to_eye = (self.eye - point) / np.linalg.norm(self.eye - point)
            to_light = (light - point) / np.linalg.norm(light - point)
            tangent = -np.sin(angle) * e + np.cos(angle) * w
            return to_eye @ tangent + to_light @ tangent

        top = np.arctan2((light - centre) @ w, (light - centre) @ e)
        angle = brentq(imbalance, 0.0, top, xtol=1e-15)
        return self.project(centre + radius * (np.cos(angle) * e + np.sin(angle) * w))


@pytest.fixture(scope="session")
def bench() -> Bench:
    return Bench()


def codes(result):
    """Return the codes of the notices of a calibration."""
    return [notice.code for notice in result.warnings]


def outline_in(camera, sphere):
    """Return the ellipse at which the rays of a camera touch a sphere, in the image or not."""
    axis = np.array(sphere.centre_mm) - camera.centre_mm
    distance = np.linalg.norm(axis)
    axis /= distance
    first = np.cross(axis, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    angle = np.arange(0, 2 * np.pi, 0.05)
    around = np.outer(np.cos(angle), first) + np.outer(np.sin(angle), np.cross(axis, first))
    sine = sphere.radius_mm / distance
    touch = distance * (1 - sine**2) * axis + sphere.radius_mm * np.sqrt(1 - sine**2) * around
    return fit_ellipse(camera.project(camera.centre_mm + touch))[0]


def dome(count: int = 36, radius: float = 450.0):
    """Return lights on rings at elevations of 15, 35, 55 and 75 degrees."""
    rings = np.array([15, 35, 55, 75])
    share = np.cos(np.radians(rings))
    counts = np.diff(np.round(count * np.cumsum(share) / share.sum()).astype(int), prepend=0)
    angles = [
        (elevation, azimuth)
        for elevation, n in zip(np.radians(rings), counts, strict=True)
        for azimuth in np.arange(n) * 2 * np.pi / n + 0.3
    ]
    e, a = np.array(angles).T
    return radius * np.column_stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


@pytest.fixture(scope="session")
def dome_mm():
    return dome()


@pytest.fixture
def paths_exist(monkeypatch):
    """The frames are arrays without files."""
    monkeypatch.setattr(Path, "exists", lambda self: True)


@pytest.fixture(scope="module")
def chrome():
    """The images of the real chrome ball."""
    return read_source(DATA / "uw" / "chrome")


@pytest.fixture(scope="module")
def benchmark(request):
    """The module of the benchmark that a test module names, which imports others of its folder."""
    folder = str(Path(__file__).parents[2] / "benchmarks")
    sys.path.insert(0, folder)
    try:
        yield importlib.import_module(request.module.BENCHMARK)
    finally:
        sys.path.remove(folder)
        places = {name: str(getattr(one, "__file__", "")) for name, one in sys.modules.items()}
        for name in (name for name, place in places.items() if place.startswith(folder)):
            if "." not in name:
                del sys.modules[name]
