"""All that `simulator` offers; see there."""

from simulator._board.virtual_board import VirtualBoard
from simulator._camera.virtual_camera import VirtualCamera
from simulator._open_rig import open_rig, rig_for
from simulator._owned_folder import OwnedFolder, remove_abandoned
from simulator._render.chrome import Highlights, find_highlights
from simulator._render.cramer_rao import cramer_rao_deg
from simulator._render.render import Rendering, render
from simulator._render.truth import Truth
from simulator._render.truth_files import save_truth
from simulator._scene.lamps import Lamps
from simulator._scene.lens import Lens
from simulator._scene.reflectance import Ggx, Lambert, Material, OrenNayar
from simulator._scene.rig_scenes import SCENES, bench_camera, bench_sensor, dome_lights, scene_named
from simulator._scene.scene import ChromeSphere, Scene
from simulator._scene.scene_file import read_scene, write_scene
from simulator._shapes.body import Body
from simulator._shapes.carved import CrackedLeather, LizardScales, StepGauge, Textile, WoodCarving
from simulator._shapes.coin import Coin
from simulator._shapes.mesh import MeshBody
from simulator._shapes.patterns import (
    ChArUco,
    Checker,
    ColourWheel,
    Even,
    Gradient,
    Paint,
    Pattern,
)
from simulator._shapes.surface import BandNoise, Plane, Ripples, SphericalCap, Surface
from simulator._simulated_rig import simulated_rig

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
    "OwnedFolder",
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
    "remove_abandoned",
    "render",
    "rig_for",
    "save_truth",
    "scene_named",
    "simulated_rig",
    "write_scene",
]
