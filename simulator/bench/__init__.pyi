from .owned_folder import OwnedFolder as OwnedFolder
from .owned_folder import remove_abandoned as remove_abandoned
from .state import BenchState as BenchState
from .state import BenchWriter as BenchWriter
from .state import ExposurePeriod as ExposurePeriod
from .state import LitPeriod as LitPeriod
from .state import TriggerPulse as TriggerPulse
from .wiring import Wiring as Wiring
