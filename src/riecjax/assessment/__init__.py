"""Everything that is known of an answer: estimate, refinement, tests and validation in one."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
