from .candidate import Candidate as Candidate
from .candidate import Shaped as Shaped
from .candidate import default_candidates as default_candidates
from .candidate import named as named
from .discovery import Chosen as Chosen
from .discovery import Discovery as Discovery
from .search import Rejected as Rejected
from .search import Step as Step
