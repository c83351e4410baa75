"""Writer for the MAT-file of true normals in a DiLiGenT object folder."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from acquisition._storage import write_durably

# The first 116 bytes are free text, to which SciPy writes the time and the system.
_TEXT: Final = b"MATLAB 5.0 MAT-file".ljust(116)


def write_normals_mat(path: Path, normals: npt.NDArray[np.float32]) -> None:
    """Write normals ``(H, W, 3)`` as ``Normal_gt``; equal normals give equal bytes.

    Raises
    ------
    StorageError
        If the file cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from acquisition import write_normals_mat
    >>> write_normals_mat(Path("Normal_gt.mat"), np.tile(np.float32([0, 0, 1]), (4, 5, 1)))
    """
    # SciPy's writers take as long to import as the rest of this package.
    from scipy.io import savemat

    file: Any = io.BytesIO()  # SciPy's annotations allow only file names
    savemat(file, {"Normal_gt": normals.astype(np.float64)}, do_compression=True)
    write_durably(path, _TEXT, file.getbuffer()[len(_TEXT) :])
