from . import clock as clock
from . import files as files
from . import lines as lines
from . import program as program
from . import threads as threads
