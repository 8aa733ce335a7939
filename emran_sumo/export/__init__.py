"""What a paper or a slide needs of a run: a table, a sheet of figures, a video."""
