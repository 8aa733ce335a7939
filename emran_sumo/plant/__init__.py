"""What the car is: compiled, pure functions of state and parameters."""
