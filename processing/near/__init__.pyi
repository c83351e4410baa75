from .near_height import HeightStep as HeightStep
from .near_height import NearHeight as NearHeight
