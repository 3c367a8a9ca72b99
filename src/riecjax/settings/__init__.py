"""Settings, each said once: fields of frozen dataclasses."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
