"""The files behind `gtr demo`, shipped with the package.

`tdcm-1.toml` is the manipulator that the demo simulates. `concealed.csv` is what it diagnoses, starting from
`concealed.toml`: every second sample of a run of an independent simulator (rigid links, tendon through
guides) with noise added at all instruments. It was made with μ = 0.300, E = 1.5 MPa and a pulley at the base
that takes μ·angle = 0.1; the robot file says 0.35, 1.6 MPa and no pulley. `outside.csv`, with `outside.toml`,
is a run of the machine of `benchmarks/blind` whose friction rises by up to 70 % near one tension, which no
term does (`python -m benchmarks.outside_example` writes both).
"""

from pathlib import Path

FOLDER = Path(__file__).parent
SIMULATED = FOLDER / "tdcm-1.toml"
CONCEALED_ROBOT = FOLDER / "concealed.toml"
CONCEALED = FOLDER / "concealed.csv"
OUTSIDE_ROBOT = FOLDER / "outside.toml"
OUTSIDE = FOLDER / "outside.csv"
OUTSIDE_MADE_WITH = "mu = 0.24, times 1 + 0.7 exp(-((T - 20 N) / 5 N)^2)"
MADE_WITH = "mu = 0.300, E = 1.5 MPa and local-friction base = 0.1"
