"""A rig made of numbers: scenes, renderer, sensor, virtual LED board and virtual camera."""

from simulator._chrome import Highlights, find_highlights
from simulator._coin import Coin
from simulator._open_rig import open_rig, rig_for
from simulator._render import Rendering, render
from simulator._rig_scenes import SCENES, bench_camera, bench_sensor, dome_lights, scene_named
from simulator._scene import ChromeSphere, Paint, Scene
from simulator._simulated_rig import simulated_rig
from simulator._surface import BandNoise, Plane, Ripples, SphericalCap, Surface
from simulator._truth import Truth
from simulator._virtual_board import VirtualBoard
from simulator._virtual_camera import VirtualCamera

__all__ = [
    "SCENES",
    "BandNoise",
    "ChromeSphere",
    "Coin",
    "Highlights",
    "Paint",
    "Plane",
    "Rendering",
    "Ripples",
    "Scene",
    "SphericalCap",
    "Surface",
    "Truth",
    "VirtualBoard",
    "VirtualCamera",
    "bench_camera",
    "bench_sensor",
    "dome_lights",
    "find_highlights",
    "open_rig",
    "render",
    "rig_for",
    "scene_named",
    "simulated_rig",
]
