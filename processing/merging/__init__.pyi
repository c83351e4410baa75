from .adjustment import FieldPair as FieldPair
from .field_rows import FieldRows as FieldRows
from .fusion import FusionStage as FusionStage
from .merge import MergedField as MergedField
from .merge import merge_fields as merge_fields
from .placements import Placements as Placements
from .placements import place_fields as place_fields
