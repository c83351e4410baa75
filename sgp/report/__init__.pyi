from .folder import read_folder as read_folder
from .maps import FolderMaps as FolderMaps
from .maps import embed as embed
from .planes import Plane as Plane
from .planes import vectors_plane as vectors_plane
from .report import make_report as make_report
from .report import write_report as write_report
