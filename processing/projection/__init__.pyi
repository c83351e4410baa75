from .geometry_files import Geometry as Geometry
from .geometry_files import read_geometry as read_geometry
from .normal_projection import Projection as Projection
from .normal_projection import project as project
from .view import MAX_PROJECTED_PIXELS as MAX_PROJECTED_PIXELS
from .view import View as View
from .view import view_rotation as view_rotation
