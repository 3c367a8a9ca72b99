"""Numbers as printed by Best and Gordon (1999), Tables 1 to 6.

SI units, so 177.8 N/mm stands here as 177.8e3 N/m; each number keeps the paper's digits.
"""

from typing import NamedTuple

VARIANTS = ("W_true", "B_true", "W_id", "B_id")
"""Table 4's rows: equation of the wheel or the body, masses known or identified."""

CRITERIA = ("RIEC", "DOLS")

INPUTS = ("road", "pothole")
"""What models are validated on."""


class PublishedMode(NamedTuple):
    """One row of Table 1; complex numbers stand for the printed `a ± b i` with a sign."""

    eigenvalue: complex
    frequency: float | None
    damping_ratio: float | None
    wheel: complex
    body: complex
    engine_minus_body: complex
    digits: int
    """Decimals to which the eigenvalue is printed."""


TABLE_1 = (
    PublishedMode(-266, None, None, 1.00, -0.17, 0.19, 0),
    PublishedMode(-35.15 + 75.76j, 13.29, 0.42, 1.00, -0.21 - 0.29j, 0.49 + 0.67j, 2),
    PublishedMode(-26.21 + 78.75j, 13.21, 0.32, 1.00, 0.07 - 0.19j, -0.29 + 0.41j, 2),
    PublishedMode(-2.08 + 7.63j, 1.26, 0.26, 0.09 + 0.05j, 1.00, 0.01 + 0.01j, 2),
)
"""Eigenstructure of the linearised source model; eigenvector parts to two decimals."""

TABLE_3 = {
    "K_t": {"RIEC": 177.8e3, "DOLS": 177.9e3},
    "M_s": {"RIEC": 302.7, "DOLS": 240.1},
    "M_us": {"RIEC": 23.3, "DOLS": 24.0},
}
"""Identified tyre stiffness in N/m and masses in kg."""

TABLE_4 = {
    "W_true": {"RIEC": 20.9e3, "DOLS": 23.1e3},
    "B_true": {"RIEC": 20.7e3, "DOLS": 19.7e3},
    "W_id": {"RIEC": 20.8e3, "DOLS": 20.1e3},
    "B_id": {"RIEC": 20.9e3, "DOLS": 15.8e3},
}
"""Identified suspension stiffness in N/m."""

TABLE_5 = {
    "W_id": {"road": {"RIEC": 41.0, "DOLS": 70.0}, "pothole": {"RIEC": 126.2, "DOLS": 138.8}},
    "B_id": {"road": {"RIEC": 40.2, "DOLS": 57.5}, "pothole": {"RIEC": 129.8, "DOLS": 137.7}},
    "W_true": {"road": {"RIEC": 58.9, "DOLS": 87.6}, "pothole": {"RIEC": 116.2, "DOLS": 127.8}},
    "B_true": {"road": {"RIEC": 59.4, "DOLS": 65.9}, "pothole": {"RIEC": 116.9, "DOLS": 95.8}},
}
"""Validation error summed over x1 to x4, in percent (eq. 28)."""

CONTACT_SHARE = 0.99
"""Share of the identification record during which the tyre touches the road (Section 4)."""

DAMPING_RATE = 1500.0
"""Suspension damping rate of the linearisation in N s/m, "approximated" (Section 3)."""


class MountVariant(NamedTuple):
    """One row of Table 6: engine mount stiffness in N/m and damping in N s/m."""

    frequency: float
    stiffness: float
    damping: float


TABLE_6 = {
    "pathological": MountVariant(13.0, 400e3, 4000.0),
    "included-mode": MountVariant(6.0, 100e3, 2000.0),
    "higher-mode": MountVariant(25.0, 1500e3, 7750.0),
}
"""Engine resonance in Hz and the mount that gives it."""


class Table2(NamedTuple):
    """Settings of the identification process."""

    bandwidth: float = 30.0
    """Hz"""
    rms: float = 0.55
    """m/s"""
    duration: float = 40.0
    """s"""
    rate: float = 200.0
    """Hz"""
    windows: int = 8000
    alpha: float = 0.05
    """s"""
    beta: float = 0.5
    """s"""

    @property
    def sample_count(self) -> int:
        """8000, "all available data"."""
        return round(self.duration * self.rate)


TABLE_2 = Table2()
