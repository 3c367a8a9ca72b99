"""Steps between a raw recording and the record that an equation reads.

One rule holds for all of them. A step works within unbroken stretches and never reaches across a
missing sample or a pause. What it cannot compute near a gap becomes missing there, in the signals
that it treats; what it cannot compute near the record's two ends is cut off, for all signals. A
stretch that is too short for a step becomes missing as a whole, and a signal of which nothing is
left is a `DataError`.
"""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
