"""The files behind `gtr demo` and `gtr paper`, shipped with the package.

`tdcm-1.toml` is the manipulator it simulates. `recording.csv` is what it fits, starting from `recorded.toml`.
An independent simulator (rigid links, tendon through guides, noise) made the recording with μ = 0.2611 and
E = 1.335 MPa; the robot file says 0.30 and 1.5 MPa. `paper/` holds the robots of Liu & Alambeigi (RA-L 2022).
"""

from pathlib import Path

FOLDER = Path(__file__).parent
SIMULATED = FOLDER / "tdcm-1.toml"
RECORDED = FOLDER / "recorded.toml"
MADE_WITH = "mu = 0.2611 and E = 1.335 MPa"
RECORDING = FOLDER / "recording.csv"
PAPER = FOLDER / "paper"
