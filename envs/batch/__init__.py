"""Everything between true poses and what an agent sees, for N environments at once; a single environment is one row."""
