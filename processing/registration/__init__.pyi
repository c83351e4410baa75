from .field import Field as Field
from .field_registration import Registration as Registration
from .field_registration import register_fields as register_fields
from .image_shifts import ImageShifts as ImageShifts
from .image_shifts import find_image_shifts as find_image_shifts
from .plane_transform import PlaneModel as PlaneModel
