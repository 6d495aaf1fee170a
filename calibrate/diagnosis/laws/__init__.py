"""Laws that no catalogue holds: their forms, where they act, and what is found."""
