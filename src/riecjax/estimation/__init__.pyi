from .estimate import Search as Search
from .evidence import element_evidence as element_evidence
from .parameters import ParameterTable as ParameterTable
from .parameters import plan_parameters as plan_parameters
from .stages import Solution as Solution
from .stages import solve as solve
from .stages import solve_stages as solve_stages
