from .criterion import AbstractCriterion as AbstractCriterion
from .criterion import Rows as Rows
from .suited import criterion_for as criterion_for
from .test_functions import AbstractSmoothTestFunction as AbstractSmoothTestFunction
from .test_functions import AbstractTestFunction as AbstractTestFunction
from .test_functions import GradedBump as GradedBump
