from .groups import Entry as Entry
from .order import Row as Row
from .report import Fleet as Fleet
from .settings import Fleets as Fleets
from .spread import Change as Change
from .spread import Differing as Differing
from .spread import Spread as Spread
