from .desk import Desk as Desk
from .plan_sheet import PlanSheet as PlanSheet
from .screen import Screen as Screen
from .station import Light as Light
from .station import Station as Station
