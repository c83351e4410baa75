from .schedule import Event as Event
from .schedule import Schedule as Schedule
from .trial import Outcome as Outcome
from .trial import Trial as Trial
from .world import World as World
