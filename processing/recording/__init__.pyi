from .alignment import AlignChoice as AlignChoice
from .pipeline import MapFiles as MapFiles
from .pipeline import NormalsStage as NormalsStage
from .pipeline import reconstruct as reconstruct
from .reconstruction import Reconstruction as Reconstruction
