from .candidate import Candidate as Candidate
from .candidate import Shaped as Shaped
from .candidate import default_candidates as default_candidates
from .candidate import named as named
from .discover import Chosen as Chosen
from .discover import Discovery as Discovery
from .search import Rejected as Rejected
from .search import Step as Step
