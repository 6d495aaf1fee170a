"""Answers of the code as it stood at commit a34f6da, and a check of the working tree against them.

`python -m benchmarks.frozen record|check` records the answers or compares with them. The answers lie in
`answers/`, one compressed file for each group of cases.
"""
