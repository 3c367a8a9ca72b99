"""The command line; commands of other packages are made by what is public here."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
