from .candidate import Candidate as Candidate
from .candidate import Shaped as Shaped
from .discover import discover as discover
from .discovery import Discovery as Discovery
from .named import named as named
from .search import Step as Step
