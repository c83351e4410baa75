from .light_level import LightLevel as LightLevel
from .light_level import MeteringGoal as MeteringGoal
from .metering import Metered as Metered
from .metering import MeteredLight as MeteredLight
from .metering import estimate_metered as estimate_metered
from .metering import meter as meter
