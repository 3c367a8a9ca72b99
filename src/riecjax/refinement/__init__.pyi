from .integral_error import AbstractBalance as AbstractBalance
from .objective import ByFunction as ByFunction
from .objective import as_parametric_system as as_parametric_system
from .optimum import RefinementStatus as RefinementStatus
from .output_error import Tiles as Tiles
from .output_error import WholeRecord as WholeRecord
