from .image_shifts import ImageShifts as ImageShifts
from .image_shifts import find_image_shifts as find_image_shifts
