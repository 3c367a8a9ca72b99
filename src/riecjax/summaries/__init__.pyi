from .normal_equations import NormalEquations as NormalEquations
from .normal_equations import Outline as Outline
from .one_pass import stage_normal_equations as stage_normal_equations
from .one_pass import stretch_starts as stretch_starts
from .summarise import default_criterion as default_criterion
from .summarise import signals_read as signals_read
