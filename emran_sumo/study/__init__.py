"""Studies: a grid of runs with paired seeds, a store that loses nothing, and the answers drawn from it."""
