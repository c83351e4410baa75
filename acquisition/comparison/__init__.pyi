from .frame_comparison import FrameComparison as FrameComparison
from .frame_comparison import compare_frames as compare_frames
from .resampling import lanczos as lanczos
