from .frame_normals import normals_of_frames as normals_of_frames
from .method import METHODS as METHODS
from .method import Method as Method
from .method import StereoChannel as StereoChannel
from .normals_and_albedo import PhotometricStereoResult as PhotometricStereoResult
from .normals_and_albedo import photometric_stereo as photometric_stereo
from .solve import Estimator as Estimator
from .stereo_maps import StereoMaps as StereoMaps
