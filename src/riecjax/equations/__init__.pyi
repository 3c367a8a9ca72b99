from .bases import AbstractBasis as AbstractBasis
from .bases import Friction as Friction
from .bases import RoofFunctions as RoofFunctions
from .expressions import faster_than as faster_than
from .procedure import AtRest as AtRest
from .procedure import Procedure as Procedure
