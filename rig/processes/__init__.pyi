from .child import module_command as module_command
from .ending import end_program as end_program
from .ending import resend_signal as resend_signal
from .memory import memory_budget as memory_budget
from .memory import memory_of_computer as memory_of_computer
from .memory import memory_size as memory_size
