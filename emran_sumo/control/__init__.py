"""How the car is driven: compiled, pure control laws, one a file."""
