from .fleet import Fleet as Fleet
from .groups import Entry as Entry
from .spread import Change as Change
from .spread import Differing as Differing
from .spread import Spread as Spread
from .sums import Row as Row
