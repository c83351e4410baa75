from .mesh_file import MeshFile as MeshFile
from .reader import read_mesh_file as read_mesh_file
