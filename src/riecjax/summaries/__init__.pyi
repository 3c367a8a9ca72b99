from .normal_equations import NormalEquations as NormalEquations
from .stage_sums import stage_normal_equations as stage_normal_equations
from .task import signals_read as signals_read
