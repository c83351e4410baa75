from .compare import LightComparison as LightComparison
from .compare import compare_lights as compare_lights
from .compare import compare_with_rig as compare_with_rig
from .order import Motion as Motion
