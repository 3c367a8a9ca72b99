from .check import Check as Check
from .check import recording_findings as recording_findings
from .columns import Doubt as Doubt
from .equation_faults import Cause as Cause
from .equation_faults import demanded as demanded
from .reading import align as align
