from .relief_normals import random_normals as random_normals
from .relief_normals import random_relief as random_relief
from .relief_normals import rugged_normals as rugged_normals
