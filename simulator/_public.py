"""All that `simulator` offers; see there."""

from simulator._body import Body
from simulator._carved import CrackedLeather, LizardScales, StepGauge, Textile, WoodCarving
from simulator._chrome import Highlights, find_highlights
from simulator._coin import Coin
from simulator._cramer_rao import cramer_rao_deg
from simulator._lamps import Lamps
from simulator._lens import Lens
from simulator._mesh import MeshBody
from simulator._open_rig import open_rig, rig_for
from simulator._patterns import (
    ChArUco,
    Checker,
    ColourWheel,
    Even,
    Gradient,
    Paint,
    Pattern,
)
from simulator._reflectance import Ggx, Lambert, Material, OrenNayar
from simulator._render import Rendering, render
from simulator._rig_scenes import SCENES, bench_camera, bench_sensor, dome_lights, scene_named
from simulator._scene import ChromeSphere, Scene
from simulator._scene_file import read_scene, write_scene
from simulator._simulated_rig import simulated_rig
from simulator._surface import BandNoise, Plane, Ripples, SphericalCap, Surface
from simulator._truth import Truth
from simulator._truth_files import save_truth
from simulator._virtual_board import VirtualBoard
from simulator._virtual_camera import VirtualCamera

__all__ = [
    "SCENES",
    "BandNoise",
    "Body",
    "ChArUco",
    "Checker",
    "ChromeSphere",
    "Coin",
    "ColourWheel",
    "CrackedLeather",
    "Even",
    "Ggx",
    "Gradient",
    "Highlights",
    "Lambert",
    "Lamps",
    "Lens",
    "LizardScales",
    "Material",
    "MeshBody",
    "OrenNayar",
    "Paint",
    "Pattern",
    "Plane",
    "Rendering",
    "Ripples",
    "Scene",
    "SphericalCap",
    "StepGauge",
    "Surface",
    "Textile",
    "Truth",
    "VirtualBoard",
    "VirtualCamera",
    "WoodCarving",
    "bench_camera",
    "bench_sensor",
    "cramer_rao_deg",
    "dome_lights",
    "find_highlights",
    "open_rig",
    "read_scene",
    "render",
    "rig_for",
    "save_truth",
    "scene_named",
    "simulated_rig",
    "write_scene",
]
