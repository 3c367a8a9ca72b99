from .differentiation import central_difference as central_difference
from .differentiation import differentiate as differentiate
from .filtering import low_pass as low_pass
from .resampling import on_grid as on_grid
