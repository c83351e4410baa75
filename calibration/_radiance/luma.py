"""Gray values of colours."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatImage = npt.NDArray[np.float32]

# ITU-R BT.601 luma, as in the published results on DiLiGenT.
LUMA = np.array([0.2989, 0.587, 0.114], np.float32)


def luma(colour: FloatImage) -> FloatImage:
    """Return the gray values ``.2989 R + .587 G + .114 B`` of linear colours ``(..., 3)``.

    Examples
    --------
    >>> import numpy as np
    >>> from calibration import luma
    >>> luma(np.array([[1, 0, 0], [1, 1, 1]], np.float32)).round(4)
    array([0.2989, 0.9999], dtype=float32)
    """
    return np.asarray(colour @ LUMA, np.float32)
