"""Discovery: which terms a model lacks, chosen from one Gram matrix of all candidates."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
