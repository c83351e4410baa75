from .bench import open_bench as open_bench
from .board_only import OpenBoard as OpenBoard
from .opening import find_rig_config as find_rig_config
from .opening import open_board as open_board
from .opening import open_rig as open_rig
from .rig import Rig as Rig
