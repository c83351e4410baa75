from .plan import CapturePlan as CapturePlan
from .plan import PlanEstimate as PlanEstimate
from .plan import estimate_plan as estimate_plan
from .plan import led_numbers as led_numbers
from .plan import read_plan as read_plan
from .planned_shot import PlannedShot as PlannedShot
