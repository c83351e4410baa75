"""From linear images to normals, shape, detail and geometry."""

from processing._detail.local_transfer import LocalTransferResult, transfer_local
from processing._detail.properties import (
    ChainStep,
    DetailLikeness,
    cross_exchange,
    detail_likeness,
    idempotence,
    transfer_chain,
)
from processing._detail.rotation_similarity import RotationSimilarity, rotation_similarity
from processing._detail.seam import SeamSteps
from processing._detail.separation import Separation, combine, separate
from processing._detail.shape_filter import FilterKind, ShapeFilter
from processing._detail.similarity import Similarity
from processing._detail.transfer import TransferFidelity, TransferResult, transfer
from processing._mask import ObjectMask, object_mask
from processing._metrics import AngularError, angle_deg, angular_error, ssim
from processing._normal_map import NormalMap
from processing._normal_map_files import NormalMapFile, read_normals, write_normals
from processing._projection.mesh_read import Geometry, read_geometry
from processing._projection.project import Projection, project
from processing._projection.view import MAX_PROJECTED_PIXELS, View, view_rotation
from processing._reconstruction.reconstruct import Reconstruction, reconstruct
from processing._stereo.estimator import Estimator, Method
from processing._stereo.photometric_stereo import PhotometricStereoResult, photometric_stereo
from processing._surface.height_profile import HeightProfile, height_profile
from processing._surface.integration import HeightMap, integrate
from processing._surface.mesh_files import Mesh, height_mesh, write_mesh

__all__ = [
    "MAX_PROJECTED_PIXELS",
    "AngularError",
    "ChainStep",
    "DetailLikeness",
    "Estimator",
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
    "Reconstruction",
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
    "reconstruct",
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
