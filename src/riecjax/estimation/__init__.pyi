from .check import Check as Check
from .hidden_modes import ModeMap as ModeMap
from .mode_evidence import ModeEvidence as ModeEvidence
from .mode_evidence import mode_evidence as mode_evidence
from .stages import Solution as Solution
from .stages import solve as solve
