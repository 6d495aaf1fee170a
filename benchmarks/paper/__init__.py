"""Liu & Alambeigi, RA-L 2022, reproduced: what `make paper` runs, and the page "The paper" of the docs."""
