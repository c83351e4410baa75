from .board_page import board_of as board_of
from .board_page import squares_of as squares_of
from .board_page import write_board_page as write_board_page
from .board_views import FoundViews as FoundViews
from .board_views import find_views as find_views
from .board_views import mean_image as mean_image
from .sphere_marks import Marks as Marks
from .sphere_marks import marks_of as marks_of
