from .albedo_image import AlbedoPicture as AlbedoPicture
from .albedo_image import albedo_picture as albedo_picture
from .albedo_image import albedo_samples as albedo_samples
from .albedo_image import albedo_white as albedo_white
from .specular import specular_residual as specular_residual
