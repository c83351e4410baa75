from . import clock as clock
from . import filesystem as filesystem
from . import lines as lines
from . import program as program
from . import threads as threads
