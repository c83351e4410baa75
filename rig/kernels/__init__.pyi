from .cache import kernel_folder as kernel_folder
from .parts import INLINED as INLINED
from .parts import PART as PART
from .threads import KernelWatch as KernelWatch
from .threads import in_threads as in_threads
from .threads import private_folder as private_folder
from .threads import watch_kernels as watch_kernels
