from .lens_blur import LensBlur as LensBlur
from .lens_blur import lens_blur as lens_blur
from .normal_errors import UNIFORM_DEG as UNIFORM_DEG
from .normal_errors import NormalUncertainty as NormalUncertainty
from .normal_errors import normal_uncertainty as normal_uncertainty
from .sample_kind import Reason as Reason
from .sample_kind import SampleKind as SampleKind
