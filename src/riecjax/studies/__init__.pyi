from .input_design import Design as Design
from .input_design import design_input as design_input
from .input_design import predicted_standard_errors as predicted_standard_errors
from .monte_carlo import over_keys as over_keys
