from .stage import Need as Need
from .stage import NormalRows as NormalRows
from .stage import Size as Size
from .stage import Stage as Stage
from .stage import Step as Step
from .stage import computed as computed
from .stage import run_steps as run_steps
