"""Results for people and scripts: tables, JSON documents, figures, HTML."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
