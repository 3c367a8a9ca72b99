from .check import Check as Check
from .check import recording_findings as recording_findings
from .evidence import ModeEvidence as ModeEvidence
from .evidence import mode_evidence as mode_evidence
from .hidden_modes import ModeMap as ModeMap
from .parameters import plan_parameters as plan_parameters
from .stages import Solution as Solution
from .stages import solve as solve
