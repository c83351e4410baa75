from .capture_checks import Preflight as Preflight
from .capture_checks import preflight as preflight
from .capture_checks import preflight_resume as preflight_resume
from .check import Check as Check
from .rig import check_leds as check_leds
