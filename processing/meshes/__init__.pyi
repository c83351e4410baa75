from .height_dataset import height_dataset as height_dataset
from .mesh import Mesh as Mesh
from .mesh import height_mesh as height_mesh
from .mesh_files import write_mesh as write_mesh
from .solid import solid_mesh as solid_mesh
