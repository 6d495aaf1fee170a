"""Liu & Alambeigi, RA-L 2022, reproduced: what `gtr paper` runs, and the page "The paper" of the docs."""
