from .slopes import Curvature as Curvature
from .slopes import curvature as curvature
