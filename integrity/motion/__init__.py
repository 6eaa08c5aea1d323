"""What really happens to vehicles: the truth that instruments measure, and scripted drives that make it."""
