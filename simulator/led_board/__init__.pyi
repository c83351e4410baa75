from .faults import BoardFault as BoardFault
from .faults import FaultyBoard as FaultyBoard
from .faults import PowerCutError as PowerCutError
from .firmware import BoardFirmware as BoardFirmware
from .outputs import ActiveInput as ActiveInput
from .outputs import BoardOutputs as BoardOutputs
from .virtual_board import VirtualBoard as VirtualBoard
