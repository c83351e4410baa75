"""Arrays of any shape, by the type of their elements; for annotations."""

from typing import Any

import numpy as np
import numpy.typing as npt

Bool = npt.NDArray[np.bool_]
Int8 = npt.NDArray[np.int8]
Int16 = npt.NDArray[np.int16]
Int32 = npt.NDArray[np.int32]
Int64 = npt.NDArray[np.int64]
Intp = npt.NDArray[np.intp]
UInt8 = npt.NDArray[np.uint8]
UInt16 = npt.NDArray[np.uint16]
UInt32 = npt.NDArray[np.uint32]
UInt64 = npt.NDArray[np.uint64]
Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Complex64 = npt.NDArray[np.complex64]
Integer = npt.NDArray[np.integer]
Unsigned = npt.NDArray[np.unsignedinteger]
Floating = npt.NDArray[np.floating]
Str = npt.NDArray[np.str_]
Void = npt.NDArray[np.void]
Generic = npt.NDArray[np.generic]
AnyArray = npt.NDArray[Any]
