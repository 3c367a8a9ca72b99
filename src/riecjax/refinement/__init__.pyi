from .integral_error import AbstractBalance as AbstractBalance
from .optimum import RefinementStatus as RefinementStatus
from .parametric import ByFunction as ByFunction
from .shots import RandomShots as RandomShots
from .shots import Tiles as Tiles
from .shots import WholeRecord as WholeRecord
