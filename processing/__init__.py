"""From linear images to normals, shape, detail and geometry."""

from processing._height_profile import HeightProfile, height_profile
from processing._integration import HeightMap, integrate
from processing._local_transfer import LocalTransferResult, transfer_local
from processing._mask import ObjectMask, object_mask
from processing._mesh_files import Mesh, height_mesh, write_mesh
from processing._mesh_read import Geometry, read_geometry
from processing._metrics import AngularError, angle_deg, angular_error, ssim
from processing._normal_map import NormalMap
from processing._normal_map_files import NormalMapFile, read_normals, write_normals
from processing._photometric_stereo import (
    Method,
    PhotometricStereoResult,
    photometric_stereo,
)
from processing._project import Projection, project
from processing._project_view import MAX_PROJECTED_PIXELS, View, view_rotation
from processing._properties import (
    ChainStep,
    DetailLikeness,
    cross_exchange,
    detail_likeness,
    idempotence,
    transfer_chain,
)
from processing._rotation_similarity import RotationSimilarity, rotation_similarity
from processing._seam import SeamSteps
from processing._separation import Separation, combine, separate
from processing._shape_filter import FilterKind, ShapeFilter
from processing._similarity import Similarity
from processing._transfer import TransferFidelity, TransferResult, transfer

__all__ = [
    "MAX_PROJECTED_PIXELS",
    "AngularError",
    "ChainStep",
    "DetailLikeness",
    "FilterKind",
    "Geometry",
    "HeightMap",
    "HeightProfile",
    "LocalTransferResult",
    "Mesh",
    "Method",
    "NormalMap",
    "NormalMapFile",
    "ObjectMask",
    "PhotometricStereoResult",
    "Projection",
    "RotationSimilarity",
    "SeamSteps",
    "Separation",
    "ShapeFilter",
    "Similarity",
    "TransferFidelity",
    "TransferResult",
    "View",
    "angle_deg",
    "angular_error",
    "combine",
    "cross_exchange",
    "detail_likeness",
    "height_mesh",
    "height_profile",
    "idempotence",
    "integrate",
    "object_mask",
    "photometric_stereo",
    "project",
    "read_geometry",
    "read_normals",
    "rotation_similarity",
    "separate",
    "ssim",
    "transfer",
    "transfer_chain",
    "transfer_local",
    "view_rotation",
    "write_mesh",
    "write_normals",
]
