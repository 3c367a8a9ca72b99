from .laws import DensityLaw as DensityLaw
from .laws import SteppedLaw as SteppedLaw
from .rows import Rows as Rows
from .smooth_test_functions import AbstractSmoothTestFunction as AbstractSmoothTestFunction
from .smooth_test_functions import GradedBump as GradedBump
from .test_functions import AbstractTestFunction as AbstractTestFunction
from .test_functions import expected_gain as expected_gain
