"""``python -m sgp``: the command ``sgp``.

The package is loaded by `start.pth` before Python searches the working directory.
"""

import os
import sys

import sgp

# `python -m` searches the working directory first, where a file may have the name of any module.
if sys.path[:1] in ([""], [os.getcwd()]) and os.path.dirname(sgp.__path__[0]) != os.getcwd():
    del sys.path[0]

if __name__ == "__main__":
    sgp.main()
