from .captioned_images import Caption as Caption
from .export import Export as Export
from .export import prepare_export as prepare_export
from .notes import Layout as Layout
