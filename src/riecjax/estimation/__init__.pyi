from .check import Check as Check
from .least_squares import Solution as Solution
from .least_squares import solve as solve
