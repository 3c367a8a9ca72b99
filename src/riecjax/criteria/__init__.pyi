from .bump import AbstractSmoothTestFunction as AbstractSmoothTestFunction
from .laws import DensityLaw as DensityLaw
from .laws import SteppedLaw as SteppedLaw
from .rows import Rows as Rows
from .test_functions import AbstractTestFunction as AbstractTestFunction
from .test_functions import expected_gain as expected_gain
