from .drivers import find_rig_file as find_rig_file
from .drivers import rig_names as rig_names
from .rig_file import Mounting as Mounting
from .rig_file import RigConfig as RigConfig
from .rig_file import read_rig_config as read_rig_config
