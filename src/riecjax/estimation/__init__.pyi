from .check import Check as Check
from .hidden_modes import ModeMap as ModeMap
from .least_squares import Solution as Solution
from .least_squares import solve as solve
from .mode_count import CarriedModes as CarriedModes
from .mode_count import carried_modes as carried_modes
from .mode_evidence import ModeEvidence as ModeEvidence
from .mode_evidence import mode_evidence as mode_evidence
