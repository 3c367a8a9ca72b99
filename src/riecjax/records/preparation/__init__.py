"""Steps between a raw recording and the record that an equation reads."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
