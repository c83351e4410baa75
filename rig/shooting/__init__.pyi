from .shooting import Wires as Wires
from .shot import Shot as Shot
from .shot_times import ShotTimes as ShotTimes
