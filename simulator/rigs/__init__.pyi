from .bench_rig import simulated_rig as simulated_rig
from .opening import BenchFlaws as BenchFlaws
from .opening import open_rig as open_rig
from .opening import open_rig_seeing as open_rig_seeing
