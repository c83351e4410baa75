"""``python -P -m sgp``: the command ``sgp``.

Without ``-P``, Python searches the working directory for ``sgp`` and for modules of its own before
this file runs; only what is imported later is searched elsewhere.
"""

import os
import sys

import sgp

# `python -m` searches the working directory first, where a file may have the name of any module.
if sys.path[:1] in ([""], [os.getcwd()]) and os.path.dirname(sgp.__path__[0]) != os.getcwd():
    del sys.path[0]

if __name__ == "__main__":
    sgp.main()
