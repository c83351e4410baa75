from .compare import LightComparison as LightComparison
from .compare import compare_lights as compare_lights
from .compare import compare_with_rig as compare_with_rig
from .order import Motion as Motion
from .series import FALSE_ALARM as FALSE_ALARM
from .series import LightDrift as LightDrift
from .series import light_drift as light_drift
from .series import order_by_date as order_by_date
