"""Who drives, and what people run: controllers, learning, benchmarks and the command line."""
