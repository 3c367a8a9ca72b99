"""Physical parameters of reduced mechanical models, by the randomized integral error criterion.

What there is stands in `__init__.pyi`.
"""

from riecjax import shows
from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)


def _register_views() -> None:
    """Import what says how objects are shown, which registers itself: when one first is."""
    import riecjax.reporting.checking
    import riecjax.reporting.discovery
    import riecjax.reporting.plots
    import riecjax.reporting.result_files
    import riecjax.reporting.views  # noqa: F401


shows.registered_by(_register_views)
