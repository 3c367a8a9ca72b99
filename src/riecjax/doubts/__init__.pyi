from .columns import Doubt as Doubt
from .equation_faults import Cause as Cause
from .equation_faults import demanded as demanded
