from .explanation import Explanation as Explanation
from .quality import ImageQuality as ImageQuality
from .quality import image_quality as image_quality
from .verdict import MISSING_DEG as MISSING_DEG
from .verdict import Answer as Answer
from .verdict import Cause as Cause
from .verdict import Verdict as Verdict
