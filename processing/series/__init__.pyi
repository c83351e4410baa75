from .strengths import LightStrengths as LightStrengths
from .strengths import light_strengths as light_strengths
