"""From linear images to normals, shape, detail and geometry."""

from processing._integration import HeightMap, integrate
from processing._mask import ObjectMask, object_mask
from processing._mesh_files import Mesh, height_mesh, write_mesh
from processing._metrics import AngularError, angle_deg, angular_error, ssim
from processing._normal_map import NormalMap
from processing._normal_map_files import NormalMapFile, read_normals, write_normals
from processing._photometric_stereo import (
    Method,
    PhotometricStereoResult,
    photometric_stereo,
)
from processing._separation import Separation, combine, separate
from processing._shape_filter import FilterKind, ShapeFilter
from processing._transfer import TransferResult, transfer

__all__ = [
    "AngularError",
    "FilterKind",
    "HeightMap",
    "Mesh",
    "Method",
    "NormalMap",
    "NormalMapFile",
    "ObjectMask",
    "PhotometricStereoResult",
    "Separation",
    "ShapeFilter",
    "TransferResult",
    "angle_deg",
    "angular_error",
    "combine",
    "height_mesh",
    "integrate",
    "object_mask",
    "photometric_stereo",
    "read_normals",
    "separate",
    "ssim",
    "transfer",
    "write_mesh",
    "write_normals",
]
