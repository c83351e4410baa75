from .quality import ImageQuality as ImageQuality
from .quality import image_quality as image_quality
from .scheme_check import Disagreement as Disagreement
from .scheme_check import SchemeCheck as SchemeCheck
from .strengths import LightStrengths as LightStrengths
from .strengths import light_strengths as light_strengths
from .verdict import Cause as Cause
from .verdict import Verdict as Verdict
